"""The device's own arithmetic in Python: libruffini through ctypes."""

from ruffini.core.pipeline import Frame, Pipeline
from ruffini.native import native_folder

__all__ = ["Frame", "Pipeline", "native_folder"]
