"""The graph of the submaps' poses: what scan matching says from one to the next, and the loops between them.

The poses are found with gtsam: Gauss-Newton with Levenberg's and Marquardt's damping, and where loops may be false with
graduated non-convexity (Yang, Antonante, Tzoumas and Carlone, "Graduated non-convexity for robust spatial perception",
2020), in which the edges of the chain are known to be true. Covariances come from the normal equations here, because
gtsam's joint marginals of many pairs take a factorisation each.

A covariance is that of a small motion in the frame of the later pose: in the plane x, y, heading, in space translation
and rotation vector. Poses are rows, of three numbers in the plane and of twelve in space; the graph's geometry says
what they mean (:mod:`localisation.slam.planar`, :mod:`localisation.slam.spatial`).
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hexmap.base.arrays import FloatArray, IntArray
from hexmap.base.atomic_files import atomic_path
from hexmap.base.errors import MissingDependencyError
from hexmap.base.values import one_line
from localisation.slam.planar import PLANE, PlaneGeometry
from localisation.slam.spatial import SpaceGeometry

__all__ = ["Edge", "PoseGraph", "import_gtsam"]

# So stiff is the first pose: the frame is where it is.
_FIXED = 1e-6
# A loop keeps this weight of 0 to 1 at least, or the robust solution has thrown it out.
_KEPT = 0.5


def import_gtsam() -> Any:
    """Return the module.

    Raises:
        MissingDependencyError: it is not installed, or cannot be loaded.
    """
    try:
        import gtsam
    except (ImportError, OSError) as error:
        raise MissingDependencyError(
            f"closing loops needs the package gtsam, which cannot be loaded ({error}); pip install gtsam, or "
            "--no-loop-closure"
        ) from error
    return gtsam


@dataclass(frozen=True, eq=False)
class Edge:
    """What is known of one pose seen from another.

    Attributes:
        i: number of the node that is seen from.
        j: number of the node that is seen.
        pose: T_i_j as a row, (3,) or in space (12,).
        covariance: (3, 3), or in space (6, 6), of a small motion in the frame of j.
        loop: whether it closes a loop, and so may be false.
    """

    i: int
    j: int
    pose: FloatArray
    covariance: FloatArray
    loop: bool = False

    __repr__ = one_line


class PoseGraph:
    """Poses of nodes and the edges between them; the first node never moves.

    Attributes:
        geometry: of the plane or of space.
        edges: all edges, in the order in which they came.
        weights: (E,) what the robust solution left of each edge, 0 to 1.
    """

    def __init__(self, geometry: PlaneGeometry | SpaceGeometry = PLANE) -> None:
        """Make a graph without a node."""
        self.geometry = geometry
        self._poses: list[FloatArray] = []
        self.edges: list[Edge] = []
        self.weights: list[float] = []
        self._factors: list[Any] = []
        # Covariances as seen from the node that was asked last, as long as nothing changes them.
        self._known: dict[int, dict[int, FloatArray]] = {}
        self._solver: tuple[int, Any] | None = None

    def __len__(self) -> int:
        """Return the number of nodes."""
        return len(self._poses)

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what gtsam and scipy made: it is made again."""
        # Covariances stay: made again with more nodes in the graph, their last bits might be others.
        return {**self.__dict__, "_factors": [], "_solver": None}

    @property
    def poses(self) -> FloatArray:
        """The poses of all nodes as they are now, rows (N, 3) or in space (N, 12)."""
        return np.array(self._poses).reshape(-1, self.geometry.row)

    def moved(self, poses: FloatArray) -> PoseGraph:
        """Return the same graph with its nodes at other poses, rows (N, 3) or (N, 12)."""
        out = PoseGraph(self.geometry)
        out._poses = [np.array(pose) for pose in poses]
        out.edges, out.weights = list(self.edges), list(self.weights)
        return out

    def pose(self, node: int) -> FloatArray:
        """Return the pose of a node, a row."""
        return self._poses[node]

    def add_node(self, pose: FloatArray) -> int:
        """Add a node at a pose, a row; returns its number."""
        self._poses.append(np.asarray(pose, np.float64))
        self._solver = None
        return len(self._poses) - 1

    def add_edge(self, edge: Edge) -> int:
        """Add an edge between two nodes; returns its number."""
        # A node that hangs on one edge says nothing of those before it.
        if edge.loop:
            self._known = {}
        self._solver = None
        self.edges.append(edge)
        self.weights.append(1.0)
        return len(self.edges) - 1

    def set_covariance(self, number: int, covariance: FloatArray) -> None:
        """Say anew how sure an edge is."""
        self.edges[number] = replace(self.edges[number], covariance=covariance)
        del self._factors[number:]
        self._known, self._solver = {}, None

    # ------------------------------------------------------------------ solving

    def optimise(self) -> None:
        """Move the nodes to where the edges that are believed want them."""
        if len(self) < 2:
            return
        gtsam = import_gtsam()
        graph = self._graph(gtsam, [e for e, weight in enumerate(self.weights) if weight >= _KEPT])
        params = gtsam.LevenbergMarquardtParams()
        self._take(gtsam.LevenbergMarquardtOptimizer(graph, self._values(gtsam), params).optimize())

    def optimise_robustly(self, probability: float = 0.999) -> list[int]:
        """Move the nodes, and throw out loops that do not fit; the edges of the chain are known to be true.

        Args:
            probability: of a true loop to be kept.

        Returns:
            The numbers of the edges that were believed before and are thrown out now.
        """
        loops = [e for e, edge in enumerate(self.edges) if edge.loop and self.weights[e] >= _KEPT]
        if not loops:
            self.optimise()
            return []
        gtsam = import_gtsam()
        chosen = [e for e, edge in enumerate(self.edges) if not edge.loop] + loops
        params = gtsam.GncLMParams()
        params.setLossType(gtsam.GncLossType.TLS)
        params.setKnownInliers([*range(len(chosen) - len(loops)), len(chosen)])
        solver = gtsam.GncLMOptimizer(self._graph(gtsam, chosen), self._values(gtsam), params)
        solver.setInlierCostThresholdsAtProbability(probability)
        self._take(solver.optimize())
        kept = np.asarray(solver.getWeights())[: len(chosen)]
        out = []
        for e, weight in zip(chosen, kept.tolist(), strict=True):
            if self.edges[e].loop and weight < _KEPT:
                self.weights[e] = 0.0
                out.append(e)
        # Once more without them: the last round of the robust solution may not have settled.
        self.optimise()
        return out

    def _graph(self, gtsam: Any, chosen: Sequence[int]) -> Any:
        """Return some of the edges as factors, and last the place of the first node."""
        while len(self._factors) < len(self.edges):
            edge = self.edges[len(self._factors)]
            self._factors.append(self.geometry.between_factor(gtsam, edge.i, edge.j, edge.pose, edge.covariance))
        graph = gtsam.NonlinearFactorGraph()
        for e in chosen:
            graph.add(self._factors[e])
        fixed = gtsam.noiseModel.Isotropic.Sigma(self.geometry.dof, _FIXED)
        graph.add(self.geometry.prior_factor(gtsam, 0, self._poses[0], fixed))
        return graph

    def _values(self, gtsam: Any) -> Any:
        values = gtsam.Values()
        for k, pose in enumerate(self._poses):
            values.insert(k, self.geometry.pose(gtsam, pose))
        return values

    def _take(self, values: Any) -> None:
        self._known, self._solver = {}, None
        # The first node's row is not touched: the frame of the map must not move by a rounding error.
        for k in range(1, len(self)):
            self._poses[k] = self.geometry.row_of(values, k)

    # ------------------------------------------------------------------ how sure

    def residuals(self) -> FloatArray:
        """Return the squared normalised residual (E,) of every edge at the poses as they are now."""
        if not self.edges:
            return np.zeros(0)
        poses = self.poses
        i, j = np.array([e.i for e in self.edges]), np.array([e.j for e in self.edges])
        geometry = self.geometry
        off = geometry.small(
            geometry.between(np.array([e.pose for e in self.edges]), geometry.between(poses[i], poses[j]))
        )
        covariances = np.array([e.covariance for e in self.edges])
        return np.einsum("ea,ea->e", off, np.linalg.solve(covariances, off[..., None])[..., 0])

    def relative_covariances(self, origin: int, others: Sequence[int]) -> FloatArray:
        """Return the covariances (M, d, d) of other nodes as seen from one node: small motions in the others' frames.

        With the node held where it is, its own uncertainty drops out: the marginals of the others are those of their
        poses relative to it.
        """
        known = self._known.get(origin)
        if known is None:
            # What was asked for from other nodes is not asked for again.
            known = {origin: np.zeros((self.geometry.dof, self.geometry.dof))}
            self._known = {origin: known}
        missing = [node for node in dict.fromkeys(others) if node not in known]
        if missing:
            known.update(zip(missing, self._solve(origin, missing), strict=True))
        return np.array([known[node] for node in others]).reshape(-1, self.geometry.dof, self.geometry.dof)

    def _solve(self, origin: int, others: Sequence[int]) -> FloatArray:
        """Return what :meth:`relative_covariances` does, of nodes that are not the one held."""
        d = self.geometry.dof
        out = np.zeros((len(others), d, d))
        wanted = list(enumerate(others))
        if self._solver is None or self._solver[0] != origin:
            self._solver = (origin, self._factorise(origin))
        solver = self._solver[1]
        size = d * (len(self) - 1)
        for begin in range(0, len(wanted), 64):
            some = wanted[begin : begin + 64]
            at = np.array([d * (node - (node > origin)) for _, node in some])
            units = np.zeros((size, d * len(some)))
            entries = (at[:, None] + np.arange(d)).ravel()
            units[entries, np.arange(d * len(some))] = 1.0
            solved = solver.solve(units)
            for s, (m, _) in enumerate(some):
                block = solved[at[s] : at[s] + d, d * s : d * s + d]
                out[m] = 0.5 * (block + block.T)
        return out

    def _factorise(self, origin: int) -> Any:
        """Return the factors of the normal equations with one node held."""
        from scipy.sparse import csc_matrix
        from scipy.sparse.linalg import splu

        rows, columns, values = self._normal_equations()
        d = self.geometry.dof
        kept = (rows // d != origin) & (columns // d != origin)
        rows, columns = rows - d * (rows // d > origin), columns - d * (columns // d > origin)
        size = d * (len(self) - 1)
        matrix = csc_matrix((values[kept], (rows[kept], columns[kept])), shape=(size, size))
        return splu(matrix, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}, diag_pivot_thresh=0.0)

    def _normal_equations(self) -> tuple[IntArray, IntArray, FloatArray]:
        """Return rows, columns and values of the matrix of the normal equations at the poses as they are now."""
        edges = [e for e, weight in zip(self.edges, self.weights, strict=True) if weight >= _KEPT]
        poses = self.poses
        i, j = np.array([e.i for e in edges]), np.array([e.j for e in edges])
        information = np.linalg.inv(np.array([e.covariance for e in edges]))
        # A small motion of i looks like this in the frame of j.
        A = -self.geometry.adjoint(self.geometry.between(poses[j], poses[i]))
        At = np.swapaxes(A, 1, 2)
        blocks = [(i, i, At @ information @ A), (j, j, information), (i, j, At @ information), (j, i, information @ A)]
        d = self.geometry.dof
        one = np.arange(d)
        rows, columns, values = [], [], []
        for a, b, block in blocks:
            rows.append(np.broadcast_to((d * a)[:, None, None] + one[:, None], block.shape).ravel())
            columns.append(np.broadcast_to((d * b)[:, None, None] + one, block.shape).ravel())
            values.append(block.ravel())
        return np.concatenate(rows), np.concatenate(columns), np.concatenate(values)

    # ------------------------------------------------------------------ files

    def write_g2o(self, path: str | os.PathLike[str]) -> None:
        """Write nodes and the edges that are believed as a g2o file (VERTEX_SE2 or VERTEX_SE3:QUAT, and edges).

        Raises:
            FileAccessError: the folder is missing or not writable.
        """
        geometry = self.geometry
        with atomic_path(path) as temporary, open(temporary, "w", encoding="utf-8", newline="\n") as handle:
            for k, pose in enumerate(self._poses):
                handle.write(geometry.g2o_vertex(k, pose) + "\n")
            for edge, weight in zip(self.edges, self.weights, strict=True):
                if weight >= _KEPT:
                    information = np.asarray(np.linalg.inv(edge.covariance), np.float64)
                    handle.write(geometry.g2o_edge(edge.i, edge.j, edge.pose, information) + "\n")
