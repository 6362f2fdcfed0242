"""A part of a stream on disk: what arrived in a time, as arrays."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.files import readable
from ruffini.rig.stream_watch import KINDS, Window

NAMED: dict[str, Any] = dict(zip(Window._fields, KINDS, strict=True))


def packed(window: Window, session: str) -> bytes:
    """The window as an .npz file."""
    columns: dict[str, npt.NDArray[Any]] = {"session": np.array(session)}
    for name, kind in NAMED.items():
        samples = getattr(window, name)
        for field in kind._fields if samples else ():
            values = [getattr(s, field) for s in samples]
            if not any(v is None for v in values):
                columns[f"{name}.{field}"] = np.array(values)
    stream = io.BytesIO()
    np.savez(stream, allow_pickle=False, **columns)
    return stream.getvalue()


def read_window(path: Path, window: Window) -> str:
    """Add what a file holds to a window; its session."""
    with np.load(readable(path)) as file:
        columns = {name: file[name] for name in file.files}
    for name, kind in NAMED.items():
        parts = [columns.get(f"{name}.{field}") for field in kind._fields]
        n = 0 if parts[0] is None else len(parts[0])
        getattr(window, name).extend(kind(*(None if p is None else _plain(p[i]) for p in parts)) for i in range(n))
    return str(columns["session"])


def _plain(value: Any) -> Any:
    """Numbers as Python's own, arrays as they are."""
    return value.item() if np.ndim(value) == 0 else value
