"""Find a robot in a map without a start pose, and follow it.

python examples/localise.py
"""

from hexmap import Lattice, MapBuilder, Scan
from hexmap.simulator import make_building, simulate
from localisation import Localiser

# The map comes from one drive, the scans that are looked for from another.
builder = MapBuilder(Lattice.named("A2", resolution=0.05))
for moment in simulate(make_building("room"), seed=1):
    if isinstance(moment.event, Scan):
        builder.fuse(moment.event, moment.T_map_robot)

localiser = Localiser(builder.build())
for moment in list(simulate(make_building("room"), seed=2, duration=20.0))[100:]:
    estimate = localiser.add(moment.event)
    if estimate is None:
        continue  # a reading of the odometry
    if estimate.pose is None:
        print(f"{estimate.stamp:5.1f} s  {estimate.state.value}, places that fit: {len(estimate.hypotheses)}")
    elif estimate.stamp % 2.0 < 0.1:
        off = (estimate.pose.inverse() @ moment.T_map_robot).translation
        sigma = estimate.covariance[[0, 1], [0, 1]] ** 0.5
        print(
            f"{estimate.stamp:5.1f} s  {estimate.pose}, {1000 * (off @ off) ** 0.5:.0f} mm off, sigma {sigma.round(3)}"
        )
