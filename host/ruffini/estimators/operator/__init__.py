"""The inverse FEM of a board as its integers, with its depth gauges and error model."""
