"""Plan a path through a simulated office on squares and on hexagons, straighten it, and draw it.

python examples/plan_a_path.py
"""

import tempfile
from pathlib import Path

import numpy as np

from hexmap.drawing.path_drawing import draw_path
from hexmap.graph.lattice_graph import LatticeGraph
from hexmap.lattice.lattice import Lattice
from hexmap.maps.cell_state import CellState
from planners import NoPath, astar, shortcut, to_cell
from planners.path_files import write_path

folder = Path(tempfile.mkdtemp())
start, goal = (0.5, 0.5), (7.5, 0.6)


# A graph can be made of anything that tells which points are free: here three rooms with doors at either end.
def free_at(points):
    x, y = points.T
    inside = (x > 0.1) & (x < 7.9) & (y > 0.1) & (y < 4.9)
    first_wall = (np.abs(x - 2.6) < 0.1) & (y < 3.8)
    second_wall = (np.abs(x - 5.3) < 0.1) & (y > 1.2)
    return inside & ~first_wall & ~second_wall


# A robot of 0.2 m, on lattices whose cells have the same area.
for name in ("Z2", "A2"):
    rooms = LatticeGraph.rasterise(free_at, Lattice.named(name, 0.1), (0, 0), (8, 5))
    graph = rooms.with_clearance(0.2, to="cell")
    path = astar(graph, to_cell(graph, start), to_cell(graph, goal), clearance=rooms.clearance(to="cell"))
    straight = shortcut(graph, path)
    print(
        f"{graph.lattice.title}: {path.length:.2f} m in {len(path)} cells, {path.clearance:.2f} m from the walls, "
        f"{path.expansions} cells expanded; straightened {straight.length:.2f} m"
    )

# Cells near walls may cost more instead: the path then keeps its distance where there is room.
careful = graph.with_soft_clearance(reach=0.6, weight=4.0, to="cell")
path = astar(careful, to_cell(careful, start), to_cell(careful, goal), clearance=rooms.clearance(to="cell"))
print(f"careful: {path.length:.2f} m at a cost of {path.cost:.2f}, {path.clearance:.2f} m from the walls")

# Where there is no path, the error says why.
try:
    astar(graph, to_cell(graph, start), to_cell(graph, (2.6, 1.0)))
except NoPath as error:
    print(error)

write_path(folder / "path.csv", path)
draw_path(
    path.points,
    folder / "path.png",
    graph,
    lambda points: np.where(free_at(points), CellState.FREE, CellState.OCCUPIED),
    extent=((0, 0), (8, 5)),
    whole=True,
    title=f"{path.length:.2f} m through three rooms",
)
print(f"see {folder}")
