"""ruffini: newtons from a camera that looks at a soft pad."""

__version__ = "0.1.0"
