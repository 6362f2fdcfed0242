"""Files that are there whole or not at all, and arrays from outside."""

from __future__ import annotations

import contextlib
import fcntl
import io
import os
import stat
import tokenize
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError

MOST_BYTES = 1 << 30  # of a file that is read into memory as a whole
MOST_ARRAY_BYTES = 4 << 30  # of a dataset of an HDF5 file
LOCK_FILE = ".lock"


def readable(path: Path, most_bytes: int | None = MOST_BYTES) -> Path:
    """`path`, if reading it ends; a missing file is for the caller to name.

    Parameters
    ----------
    most_bytes : int, optional
        None: any size, for files that are read piece by piece.

    Raises
    ------
    InputError
        It is a pipe, a socket or a device, or larger than `most_bytes`.
    """
    try:
        found = os.stat(path)
    except (OSError, ValueError):
        return path
    if not (stat.S_ISREG(found.st_mode) or stat.S_ISDIR(found.st_mode)):
        raise InputError(f"{path} is a pipe, a socket or a device: give a file")
    if most_bytes is not None and found.st_size > most_bytes:
        raise InputError(
            f"{path} has {found.st_size / 2**30:.1f} GiB, more than {most_bytes / 2**30:g} GiB: is it the right file?"
        )
    return path


def write_whole(
    path: Path, data: bytes, *, remedy: str = "choose another place or make room", is_durable: bool = True
) -> None:
    """Write a file in one step; what was there stays until all of `data` is.

    Parameters
    ----------
    is_durable : bool
        Wait until `data` is on the medium, so that not even a power cut loses both.

    Raises
    ------
    InputError
        It cannot be written; `remedy` is what to do then.
    """
    temporary = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_bytes(data)
        if is_durable:
            with temporary.open("rb") as stream:
                os.fsync(stream.fileno())
        temporary.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):
            temporary.unlink()
        raise InputError(f"{path} cannot be written ({error.strerror}): what was there is whole; {remedy}") from error


def write_new(path: Path, data: bytes, *, mode: int = 0o644) -> None:
    """Write a file in one step under a name that nothing has yet, not even a dangling link.

    Raises
    ------
    FileExistsError
        The name is taken.
    OSError
        It cannot be written; nothing is left behind.
    """
    temporary = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        with os.fdopen(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        os.link(temporary, path)
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()


def lock_alone(file: IO[Any], taken: str) -> None:
    """Lock an open file until it is closed. Raises InputError, with `taken` where another program has locked it."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise InputError(taken) from error
    except OSError as error:
        raise InputError(f"{file.name}: cannot be locked ({error.strerror}): choose a disk of this computer") from error


@contextlib.contextmanager
def only_writer(folder: Path) -> Iterator[None]:
    """Make a folder, and keep other programs from doing the same work in it. Raises InputError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = (folder / LOCK_FILE).open("w")
    except OSError as error:
        raise InputError(f"{folder} cannot be written ({error.strerror}): choose another --out") from error
    with lock:
        lock_alone(lock, f"{folder}: another run writes there now: wait for it, or choose another --out")
        try:
            yield
        finally:
            (folder / LOCK_FILE).unlink(missing_ok=True)


def dataset_values(node: Any, where: str) -> npt.NDArray[Any]:
    """The values of a dataset of an HDF5 file, whose size and kind are not believed.

    Raises
    ------
    InputError
        It is a group, has no values or no numbers, or takes more than `MOST_ARRAY_BYTES`.
    """
    if not hasattr(node, "dtype"):
        raise InputError(f"{where} is no dataset but a group: the file was not written by `ruffini`")
    if node.dtype.kind not in "biuf" or not node.shape:
        raise InputError(f"{where} is no array of numbers")
    if node.size * node.dtype.itemsize > MOST_ARRAY_BYTES:
        raise InputError(
            f"{where} has {node.size:.3g} values, more than {MOST_ARRAY_BYTES >> 30} GiB: is the file whole?"
        )
    return np.asarray(node[()])


def write_array(path: Path, array: npt.NDArray[np.generic]) -> None:
    """Write one array as NPY, under exactly this name. Raises InputError as `write_whole`."""
    stream = io.BytesIO()
    np.save(stream, array, allow_pickle=False)
    write_whole(path, stream.getvalue())


def read_array(path: Path) -> npt.NDArray[np.generic]:
    """One array of an NPY file. Its header is not believed: what the file does not hold is not allocated.

    Raises
    ------
    InputError
        There is no such file, or it is no NPY file of numbers that is whole.
    """
    try:
        return np.array(np.lib.format.open_memmap(readable(path), mode="r"))
    except (OSError, ValueError, TypeError, EOFError, OverflowError, MemoryError) as error:
        why = error.strerror if isinstance(error, OSError) and error.strerror else str(error).splitlines()[0]
    except (SyntaxError, RecursionError, tokenize.TokenError):
        why = "its header makes no sense"
    raise InputError(f"{path}: cannot be read as NPY: {why}")
