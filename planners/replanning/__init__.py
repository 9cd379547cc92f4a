"""Shortest paths in a map that changes while the robot drives."""
