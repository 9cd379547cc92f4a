"""Monte Carlo localisation as AMCL does it, on the same map and the same scans: the baseline of a localiser.

Thrun, Burgard and Fox, "Probabilistic Robotics" (2005): the sampled odometry motion model (table 5.6), a likelihood
field (section 6.4), KLD-sampling (table 8.4) and augmented recovery (table 8.3). As in AMCL an update waits until the
robot has moved, and the answer is the mean of the cluster of particles that weighs most.

Neighbouring beams are not independent, and a product of their likelihoods is far too sure of itself. AMCL adds up third
powers instead, which tells places apart so weakly that in simulated buildings none was found within twelve scans; here
the product is taken to a power, as if only a few beams were independent. That is in the filter's favour.

Everything is determined by the arguments and the generator.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from hexmap.base.arrays import FloatArray, IntArray
from hexmap.base.errors import ArgumentError
from hexmap.base.values import one_line
from hexmap.lattice.window import IndexBox
from hexmap.maps.state_rule import States
from hexmap.poses.pose import Pose, wrap_angle

__all__ = ["FilterEstimate", "FilterSettings", "LikelihoodField", "ParticleFilter", "kld_limit"]


@dataclass(frozen=True)
class FilterSettings:
    """Settings of the filter: AMCL's defaults (nav2), but for those that a start without a pose needs otherwise.

    Attributes:
        beams: of a scan that are used, evenly spread (max_beams).
        z_hit: share of the beams that meet the map.
        z_rand: share of beams that end anywhere.
        sigma_hit: metres by which a beam misses a wall.
        farthest: metres from a wall beyond which all is alike (laser_likelihood_max_dist).
        range: metres over which random beams spread (laser_max_range).
        independent: as how many independent beams a scan counts. Of 4, 8 and 16 the first found most robots in the
            simulated office, with any start: more are sure of a wrong place before the right one has a particle.
        alpha: variances of the motion's noise, 20 % of each update (AMCL's 0.2 is 45 %, which is a very bad robot):
            turn by turn, turn by metres, metres by metres, metres by turn.
        least: particles at the least, and
        most: at the most. AMCL's defaults are 500 and 2000, too few for a whole building: more is in its favour.
        error: largest error between true and estimated distribution (pf_err).
        quantile: upper standard normal quantile of it (pf_z).
        cell_metres: bins of KLD-sampling and of clusters.
        cell_radians: the same for the heading.
        step_metres: what the robot moves before a scan is taken (update_min_d).
        step_radians: the same for a turn (update_min_a).
        slow: rates of the averages of the weights that tell when to scatter random particles (recovery_alpha_slow),
        fast: and recovery_alpha_fast; AMCL recommends 0.001 and 0.1, its defaults switch recovery off.
    """

    beams: int = 60
    z_hit: float = 0.5
    z_rand: float = 0.5
    sigma_hit: float = 0.2
    farthest: float = 2.0
    range: float = 100.0
    independent: float = 4.0
    alpha: tuple[float, float, float, float] = (0.04, 0.04, 0.04, 0.04)
    least: int = 500
    most: int = 10_000
    error: float = 0.05
    quantile: float = 0.99
    cell_metres: float = 0.5
    cell_radians: float = math.radians(10.0)
    step_metres: float = 0.25
    step_radians: float = 0.2
    slow: float = 0.001
    fast: float = 0.1


@dataclass(frozen=True, eq=False)
class FilterEstimate:
    """Where the filter takes the robot to be.

    Attributes:
        pose: T_map_robot, the mean of the heaviest cluster.
        covariance: (3, 3) of its particles: x, y (metres, map's frame), heading (radians).
        weight: share of all weight in that cluster, 0 to 1.
        particles: how many there are.
    """

    pose: Pose
    covariance: FloatArray
    weight: float
    particles: int

    __repr__ = one_line


class LikelihoodField:
    """What a beam that ends in a cell says, by the distance of its centre from the nearest occupied cell's.

    Attributes:
        free: (F, 2) centres of the free cells, where a robot can be.
    """

    def __init__(self, states: States, settings: FilterSettings) -> None:
        """Compute the field around all occupied cells.

        Raises:
            ArgumentError: the map has no occupied or no free cell.
        """
        from localisation.experiments.baselines import _particle_kernels as kernels

        if len(states.occupied) == 0 or len(states.free) == 0:
            raise ArgumentError("a particle filter needs a map with occupied and free cells")
        self.lattice = states.occupied.lattice
        self.free = states.free.centres()
        reach = np.ceil(settings.farthest * np.linalg.norm(np.linalg.inv(self.lattice.basis), axis=1))
        box = IndexBox.of_cells(states.occupied.index).padded(reach.astype(np.int64))
        tree = cKDTree(states.occupied.centres())
        centres = self.lattice.centres(box.cells())
        # Farther than that the Gaussian is nothing beside the random beams, to the last digit that counts.
        seen = min(settings.farthest, 6.0 * settings.sigma_hit)
        distance = tree.query(centres, distance_upper_bound=seen)[0]
        distance = np.minimum(distance, settings.farthest)
        values = self.log_likelihood(distance, settings)
        beyond = float(self.log_likelihood(np.array([settings.farthest]), settings)[0])
        self.box = box
        self.field = kernels.Field(np.ascontiguousarray(values), box.low, box.shape, beyond)

    @staticmethod
    def log_likelihood(distance: FloatArray, settings: FilterSettings) -> FloatArray:
        """Return the logarithm of a beam's likelihood at a distance from the nearest wall, metres."""
        s = settings
        return np.asarray(np.log(s.z_hit * np.exp(-0.5 * (distance / s.sigma_hit) ** 2) + s.z_rand / s.range))

    def weigh(self, particles: FloatArray, beams: FloatArray) -> FloatArray:
        """Return the log-likelihood (P,) of particles (P, 3) by the ends of beams (B, 2) in the robot's frame."""
        from localisation.experiments.baselines import _particle_kernels as kernels

        out = np.empty(len(particles))
        kernels.weigh(
            np.ascontiguousarray(particles), np.ascontiguousarray(beams, dtype=np.float64), self.field,
            self.lattice.quantiser_tables, out,
        )  # fmt: skip
        return out


class ParticleFilter:
    """The filter; fed with scans and the odometry at each.

    Args:
        field: of the map.
        rng: of everything that is drawn.
        settings: all settings.
        mount: T_robot_laser.
        start: T_map_robot with sigmas in metres and radians; None: anywhere on free cells.
    """

    def __init__(
        self,
        field: LikelihoodField,
        rng: np.random.Generator,
        settings: FilterSettings | None = None,
        *,
        mount: Pose | None = None,
        start: tuple[Pose, float, float] | None = None,
    ) -> None:
        """Scatter the particles."""
        self.field, self.rng = field, rng
        self.settings = settings or FilterSettings()
        self.mount = mount or Pose.identity(2)
        if start is None:
            self.particles = self._anywhere(self.settings.most)
        else:
            pose, metres, radians = start
            noise = rng.standard_normal((self.settings.most, 3)) * [metres, metres, radians]
            self.particles = noise + np.array([pose.x, pose.y, pose.theta])
        self.weights = np.full(len(self.particles), 1.0 / len(self.particles))
        self._slow = self._fast = 0.0
        self._T_odom_robot: Pose | None = None
        self._begun = False

    def add(self, points: FloatArray, odometry: Pose | None) -> FilterEstimate:
        """Take a scan (P, 2) in the laser's frame and T_odom_robot at it; return where the robot is.

        Without odometry the motion is unknown: then it is taken to be none, as AMCL would.
        """
        s = self.settings
        if odometry is None:
            moved = True
        elif self._T_odom_robot is None:
            self._T_odom_robot, moved = odometry, True
        else:
            motion = self._T_odom_robot.inverse() @ odometry
            moved = float(np.linalg.norm(motion.translation)) >= s.step_metres or motion.angle >= s.step_radians
            if moved:
                self._T_odom_robot = odometry
                self._move(motion)
        if (moved or not self._begun) and len(points):
            self._begun = True
            self._measure(self.mount.apply(_spread(points, s.beams)))
            self._resample()
        return self.estimate()

    # ------------------------------------------------------------------ the three steps

    def _move(self, motion: Pose) -> None:
        """Sample the motion of every particle (table 5.6)."""
        a1, a2, a3, a4 = self.settings.alpha
        trans = float(np.linalg.norm(motion.translation))
        # A robot that turns on the spot has no direction of motion; noise alone would decide it.
        first = 0.0 if trans < 0.01 else math.atan2(motion.y, motion.x)
        second = float(wrap_angle(motion.theta - first))
        # A robot that drives backwards is not one that turns round twice.
        turns = [min(abs(v), abs(abs(v) - math.pi)) for v in (first, second)]
        noise = self.rng.standard_normal((len(self.particles), 3))
        one = first - noise[:, 0] * math.sqrt(a1 * turns[0] ** 2 + a2 * trans**2)
        way = trans - noise[:, 1] * math.sqrt(a3 * trans**2 + a4 * (turns[0] ** 2 + turns[1] ** 2))
        two = second - noise[:, 2] * math.sqrt(a1 * turns[1] ** 2 + a2 * trans**2)
        heading = self.particles[:, 2] + one
        self.particles = np.stack(
            [
                self.particles[:, 0] + way * np.cos(heading),
                self.particles[:, 1] + way * np.sin(heading),
                wrap_angle(heading + two),
            ],
            axis=1,
        )

    def _measure(self, beams: FloatArray) -> None:
        """Weigh the particles by a scan, and follow how well the map fits."""
        s = self.settings
        independent = min(1.0, s.independent / len(beams))
        likelihood = self.field.weigh(self.particles, beams) * independent
        most = float(likelihood.max())
        weights = self.weights * np.exp(likelihood - most)
        total = float(weights.sum())
        average = total * math.exp(most)
        self._slow = average if self._slow == 0.0 else self._slow + s.slow * (average - self._slow)
        self._fast = average if self._fast == 0.0 else self._fast + s.fast * (average - self._fast)
        self.weights = weights / total

    def _resample(self) -> None:
        """Draw as many particles as KLD-sampling wants, some of them anywhere where the map fits badly."""
        s = self.settings
        lost = max(0.0, 1.0 - self._fast / self._slow)
        anywhere = self.rng.random(s.most) < lost
        chosen = np.searchsorted(np.cumsum(self.weights), self.rng.random(s.most), side="right")
        drawn = self.particles[np.minimum(chosen, len(self.particles) - 1)]
        if anywhere.any():
            drawn[anywhere] = self._anywhere(int(anywhere.sum()))
            # So that random particles are not scattered again at once.
            self._slow = self._fast = 0.0
        # Of the particles drawn so far, how many bins they fill, and whether they are enough.
        _, first = np.unique(self._bins(drawn), axis=0, return_index=True)
        new = np.zeros(len(drawn), np.int64)
        new[first] = 1
        wanted = np.maximum(kld_limit(np.cumsum(new), s.error, s.quantile), s.least)
        enough = np.flatnonzero(np.arange(1, len(drawn) + 1) >= wanted)
        count = int(enough[0]) + 1 if len(enough) else len(drawn)
        self.particles = drawn[:count]
        self.weights = np.full(count, 1.0 / count)

    def _anywhere(self, count: int) -> FloatArray:
        """Return particles (count, 3) anywhere on free cells, in any heading."""
        free = self.field.free
        at = free[self.rng.integers(0, len(free), count)]
        return np.column_stack([at, self.rng.uniform(-math.pi, math.pi, count)])

    # ------------------------------------------------------------------ the answer

    def _bins(self, particles: FloatArray) -> IntArray:
        s = self.settings
        turns = round(2.0 * math.pi / s.cell_radians)
        heading = np.floor((particles[:, 2] + math.pi) / (2.0 * math.pi) * turns).astype(np.int64) % turns
        return np.column_stack([np.floor(particles[:, :2] / s.cell_metres).astype(np.int64), heading])

    def estimate(self) -> FilterEstimate:
        """Return mean and covariance of the heaviest cluster: particles whose bins touch."""
        bins, bin_of = np.unique(self._bins(self.particles), axis=0, return_inverse=True)
        turns = round(2.0 * math.pi / self.settings.cell_radians)
        shifted = bins - np.array([*bins[:, :2].min(axis=0), 0])
        size = [float(v) for v in shifted[:, :2].max(axis=0) + 3]  # wider than the bins: only headings wrap around
        pairs = cKDTree(shifted.astype(np.float64), boxsize=[*size, turns]).query_pairs(
            1.0, p=math.inf, output_type="ndarray"
        )
        links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(bins), len(bins)))
        cluster_of = connected_components(links, directed=False)[1][bin_of.ravel()]
        heavy = np.bincount(cluster_of, self.weights)
        inside = cluster_of == int(heavy.argmax())
        w = self.weights[inside] / self.weights[inside].sum()
        x, y, theta = self.particles[inside].T
        mean = [float((w * x).sum()), float((w * y).sum())]
        heading = math.atan2(float((w * np.sin(theta)).sum()), float((w * np.cos(theta)).sum()))
        off = np.stack([x - mean[0], y - mean[1], wrap_angle(theta - heading)])
        covariance = np.array([[float((w * a * b).sum()) for b in off] for a in off])
        return FilterEstimate(
            Pose.planar(mean[0], mean[1], heading), covariance, float(heavy.max()), len(self.particles)
        )


def kld_limit(bins: IntArray, error: float, quantile: float) -> FloatArray:
    """Return how many particles are enough for so many filled bins (K,): Fox (2003), Eq. 13."""
    b = 2.0 / (9.0 * np.maximum(bins - 1, 1))
    wanted = (bins - 1) / (2.0 * error) * (1.0 - b + np.sqrt(b) * quantile) ** 3
    return np.where(bins <= 1, 1.0, np.ceil(wanted))


def _spread(points: FloatArray, count: int) -> FloatArray:
    """Return at most ``count`` of the points, evenly spread over the scan."""
    if len(points) <= count:
        return points
    return np.asarray(points[np.linspace(0, len(points) - 1, count).astype(np.int64)])
