"""Results that are expensive and always the same, kept between runs and shared between the workers of one run.

A result is found again by the hash of the function's name, its arguments and the code version: every source of the
host package, the native library, the interpreter, numpy and scipy. One worker makes it, the others wait for it. A file
whose checksum does not fit is made again. RUFFINI_TEST_CACHE names the folder; an empty one costs time only.
"""

from __future__ import annotations

import fcntl
import functools
import hashlib
import os
import pickle
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")

SHA_BYTES = 32
MAX_FILES = 400  # the least recently used go first


def cache_folder() -> Path:
    """The folder of everything that tests keep between runs."""
    base = os.environ.get("RUFFINI_TEST_CACHE")
    if base:
        return Path(base)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "ruffini" / "tests"


@functools.cache
def code_version() -> bytes:
    """Hash of all that a result may depend on beside its arguments."""
    import numpy
    import scipy

    import ruffini
    from ruffini.native import native_folder

    package = Path(ruffini.__file__).parent
    found = hashlib.sha256(f"{sys.version} {numpy.__version__} {scipy.__version__}".encode())
    for path in [*sorted(package.rglob("*.py")), native_folder() / "libruffini.so"]:
        found.update(str(path.name).encode() + b"\0" + path.read_bytes())
    return found.digest()


def kept(make: Callable[..., T], *arguments: Any, **options: Any) -> T:
    """`make(*arguments, **options)`, from the cache if it is there. Arguments and result must be picklable.

    For functions without side effects whose result does not depend on what a test has patched.
    """
    name = f"{make.__module__}.{make.__qualname__}"
    said = pickle.dumps((name, arguments, sorted(options.items())), protocol=5)
    folder = cache_folder()
    path = folder / f"{name.rpartition('.')[2]}-{hashlib.sha256(code_version() + said).hexdigest()[:32]}"
    folder.mkdir(parents=True, exist_ok=True)
    with path.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if (data := _checked(path)) is None:
            data = pickle.dumps(make(*arguments, **options), protocol=5)
            _write(path, data)
            _forget_old(folder)
        else:
            os.utime(path)
    return pickle.loads(data)  # type: ignore[no-any-return]  # our own file, checked above


def _checked(path: Path) -> bytes | None:
    """The content whose checksum fits; None if there is none."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return None
    content = data[SHA_BYTES:]
    return content if hashlib.sha256(content).digest() == data[:SHA_BYTES] else None


def _write(path: Path, data: bytes) -> None:
    temporary = path.with_suffix(f".{os.getpid()}")
    temporary.write_bytes(hashlib.sha256(data).digest() + data)
    temporary.replace(path)


def _forget_old(folder: Path) -> None:
    files = sorted((p for p in folder.iterdir() if "-" in p.name and not p.suffix), key=lambda p: p.stat().st_mtime)
    for path in files[:-MAX_FILES]:
        path.unlink(missing_ok=True)
