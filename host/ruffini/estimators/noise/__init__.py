"""Noise of the displacements on untouched frames."""
