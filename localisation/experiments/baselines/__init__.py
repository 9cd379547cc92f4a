"""What others do, on the same maps: a particle filter as AMCL's, and a search on a fixed set of angles."""
