"""Paths that leave the lattice: lazy Theta* with exact line of sight, shortcuts, the true optimum."""
