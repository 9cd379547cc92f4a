"""Search for shortest paths: A*, Dijkstra, canonical orderings, their heuristics, many queries at once."""
