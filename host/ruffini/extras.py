"""Packages that only some of the commands need: the extras of host/pyproject.toml."""

from __future__ import annotations

from ruffini.errors import InputError

EXTRAS = {
    "fleet": ("distributed>=2024.5",),
    "parquet": ("pyarrow>=15",),
    "rerun": ("rerun-sdk>=0.24",),
    "robot": ("gymnasium>=1.0", "mujoco>=3.3,<4"),
    "ros": ("eclipse-zenoh>=1.0", "rosbags>=0.10"),
    "train": ("onnx>=1.16", "onnxscript>=0.3", "torch>=2.6"),
}


def missing(work: str, extra: str, otherwise: str = "") -> InputError:
    """For the person whose `work` needs them. By their own names: ruffini itself is on no package index."""
    packages = " ".join(f"'{package}'" for package in EXTRAS[extra])
    return InputError(f"{work} needs packages that are not installed: pip install {packages}{otherwise}")
