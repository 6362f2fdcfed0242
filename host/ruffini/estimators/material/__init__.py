"""E, Poisson's ratio and thickness of a pad."""
