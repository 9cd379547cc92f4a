"""The geometry that H3's users know, vectorised, on any lattice: distances, disks, rings, lines."""

import numpy as np

from hexmap import Lattice

hexagons = Lattice.named("A2", resolution=1.0)
cells = hexagons.quantise(np.array([[0.2, 0.1], [4.0, -3.0], [7.5, 2.0]]))
print("cells", cells.tolist())
print("steps from the first", hexagons.steps(np.broadcast_to(cells[0], cells.shape), cells).tolist())
print("disk of 2 steps:", len(hexagons.disk(cells[0], 2)), "cells, ring:", len(hexagons.ring(cells[0], 2)))
print("line", hexagons.line(cells[0], cells[1]).tolist())

for name in ("D3", "D3*"):
    lattice = Lattice.named(name, resolution=1.0)
    print(f"{lattice.title}: {len(lattice.neighbours)} equidistant neighbours, shells {lattice.shell_sizes}")
