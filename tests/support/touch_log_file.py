"""A calibration log of one touch, whole or spoilt on purpose."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np

from ruffini.rig.log_file import ARRAYS

Spoil = Callable[[h5py.File, h5py.Group], None]


def write_log(path: Path, n: int, spoil: Spoil = lambda file, touch: None) -> Path:
    """Write a log of one touch with n rows in each array, then spoil it."""
    with h5py.File(path, "w") as file:
        file.attrs.update(format="ruffini-calibration-log", format_version=1, facts="{}", found="{}")
        touch = file.create_group("touch/00000")
        touch.attrs["facts"] = "{}"
        for name, (columns, _) in ARRAYS.items():
            touch[name] = np.arange(float(n)) if columns is None else np.zeros((n, columns))
        spoil(file, touch)
    return path
