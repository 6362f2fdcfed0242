"""What takes long, kept between runs under `$XDG_CACHE_HOME/ruffini/twin/`: compliances of simulated pads
(`<hash>.npy`) and contacts at finite strain (`states/<hash>.npz`).

Only time depends on it: a file is taken when its name is the hash of everything that the result depends on, its shape
is right and the SHA-256 at its end fits, and left unwritten when the disk does not want it.
"""

from __future__ import annotations

import hashlib
import mmap
import os
import tempfile
import zipfile
from collections.abc import Callable
from dataclasses import astuple
from pathlib import Path
from typing import IO

import numpy as np
import numpy.typing as npt

from ruffini.files import readable
from ruffini.sim import pad
from ruffini.sim.pad import PadModel, surface_compliance

Array = npt.NDArray[np.float64]

KEPT_BYTES = 3 << 29  # compliances; 260 MB each at the default mesh, 800 MB at the finest board's
# What a contact at finite strain depends on, beside the indenters.
MECHANICS = ("complementarity", "contact", "finite", "hex27", "pad", "pose", "response", "slices", "surface")
SHA_BYTES = 32
KEPT_STATES_BYTES = 100_000_000  # 50 kB each


def cache_folder() -> Path:
    """Where the compliances are."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "ruffini" / "twin"


def _path_for(model: PadModel) -> Path:
    code = Path(pad.__file__).read_bytes()  # another element is another result
    key = hashlib.sha256(repr(astuple(model)).encode() + np.__version__.encode() + code).hexdigest()
    return cache_folder() / f"{key[:32]}.npy"


def cached_compliance(model: PadModel, *, progress: Callable[[float], None] = lambda _: None) -> Array:
    """`surface_compliance` of the model, from the cache where it is there."""
    path = _path_for(model)
    size = 3 * model.shape[0] * model.shape[1]
    try:
        _check(path)
        kept = np.load(path, mmap_mode="r", allow_pickle=False)
        if kept.shape == (size, size) and kept.dtype == np.float64:
            path.touch()
            return np.asarray(kept)
    except (OSError, ValueError, EOFError):
        pass  # not there, or not whole
    compliance = surface_compliance(model, progress=progress)
    _keep(path, compliance)
    return compliance


def cached_state(key: str, make: Callable[[], dict[str, Array]]) -> dict[str, Array]:
    """What `make` gives, from the cache where it is there. `key` says all that it depends on but our own code."""
    folder = Path(pad.__file__).parent
    files = [*(folder / f"{name}.py" for name in MECHANICS), *sorted((folder / "indenters").glob("*.py"))]
    code = b"".join(file.read_bytes() for file in files)
    name = hashlib.sha256(key.encode() + np.__version__.encode() + code).hexdigest()[:32]
    path = cache_folder() / "states" / f"{name}.npz"
    try:
        _check(path)
        with np.load(path, allow_pickle=False) as kept:
            arrays = {name: np.asarray(kept[name]) for name in kept.files}
        path.touch()
        return arrays
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, KeyError):
        pass  # not there, or not whole
    arrays = make()
    _write(path, lambda file: np.savez(file, **arrays), KEPT_STATES_BYTES)  # type: ignore[arg-type]
    return arrays


def _check(path: Path) -> None:
    """Raises ValueError if a bit of what `_write` wrote has changed since."""
    with (
        readable(path, None).open("rb") as file,
        mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as whole,
        memoryview(whole) as data,
        data[:-SHA_BYTES] as kept,
    ):
        if hashlib.sha256(kept).digest() != bytes(data[-SHA_BYTES:]):
            raise ValueError(f"{path} is spoilt")


def _keep(path: Path, compliance: Array) -> None:
    _write(path, lambda file: np.save(file, compliance), KEPT_BYTES)


def _write(path: Path, save: Callable[[IO[bytes]], None], kept_bytes: int) -> None:
    """Write a file with its SHA-256; the least recently used beside it go until at most `kept_bytes` are left."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, suffix=".part")
        try:
            with os.fdopen(handle, "wb") as file:
                save(file)
            digest = hashlib.sha256()
            with open(temporary, "r+b") as file:
                while block := file.read(1 << 20):
                    digest.update(block)
                file.write(digest.digest())
            os.replace(temporary, path)
        except OSError:
            os.unlink(temporary)
            raise
        found = [(kept.stat(), kept) for kept in path.parent.glob(f"*{path.suffix}")]
        total = 0
        for state, kept in sorted(found, key=lambda one: one[0].st_mtime, reverse=True):
            total += state.st_size
            if total > kept_bytes and kept != path:
                kept.unlink(missing_ok=True)
    except OSError:
        return  # a cache that cannot be written is no error
