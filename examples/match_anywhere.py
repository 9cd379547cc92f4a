"""Find one scan in a map, prove that nothing better is there, and say how sure it is.

python examples/match_anywhere.py
"""

from hexmap import Lattice, MapBuilder, Scan
from hexmap.simulator import make_building, simulate
from localisation import match_anywhere

drive = [m for m in simulate(make_building("room"), seed=1) if isinstance(m.event, Scan)]
builder = MapBuilder(Lattice.named("A2", resolution=0.05))
for moment in drive[::2]:
    builder.fuse(moment.event, moment.T_map_robot)
world = builder.build()

wanted = drive[51]
match = match_anywhere(world, wanted.event.points)
print(match)
print(f"true pose: {wanted.T_map_robot}")
print(f"{match.overlap:.0%} of the points meet the map, {match.contradicted:.0%} of the beams contradict it")
print(f"score {match.score} of {match.total}; no other place scores more than {match.runner_up_bound}")
