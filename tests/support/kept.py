"""Results that are expensive and always the same, kept between runs and shared between the workers of one run.

A result is found again by the hash of the function's name, its arguments and the code version: every source of the
host package, the native library, the boards, the interpreter, numpy and scipy; of a function of the tests also all
sources beside it. One worker makes it, the others wait for it. A file whose checksum does not fit is made again.
RUFFINI_TEST_CACHE names the folder; an empty one costs time only.
"""

from __future__ import annotations

import contextlib
import fcntl
import functools
import hashlib
import io
import os
import pickle
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel

T = TypeVar("T")

ROOT = Path(__file__).resolve().parents[2]
SHA_BYTES = 32
MAX_BYTES = 4 << 30  # of four versions of the code; the least recently used go first. An operator takes up to 210 MB


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
    boards = sorted((ROOT / "boards").rglob("*.toml"))
    for path in [*sorted(package.rglob("*.py")), *boards, native_folder() / "libruffini.so"]:
        found.update(str(path.name).encode() + b"\0" + path.read_bytes())
    return found.digest()


@functools.cache
def _sources_beside(module: str) -> bytes:
    """Hash of the sources in a module's folder, where it is one of the tests'."""
    source = Path(getattr(sys.modules[module], "__file__", None) or sys.executable).resolve()
    beside = sorted(source.parent.glob("*.py")) if ROOT / "tests" in source.parents else []
    return hashlib.sha256(b"".join(path.read_bytes() for path in beside)).digest()


class _KeyPickler(pickle.Pickler):
    """Equal arguments give equal bytes in every process."""

    def reducer_override(self, value: object) -> Any:
        """A pydantic model by its fields and private attributes; it also holds sets, ordered by the hash seed.

        A board's folder counts by its content: the twin's settings are in it, and tests copy it to temporary folders.
        """
        if isinstance(value, BaseModel):
            others = {name: said for name, said in vars(value).items() if name not in type(value).model_fields}
            private = sorted({**(value.__pydantic_private__ or {}), **others}.items())
            return tuple, ([type(value).__qualname__, value.model_dump_json(), private],)
        if isinstance(value, Path) and value.is_dir():
            files = [path for path in sorted(value.rglob("*")) if path.is_file()]
            return tuple, ([(str(p.relative_to(value)), hashlib.sha256(p.read_bytes()).digest()) for p in files],)
        return NotImplemented


def _key_bytes(*parts: object) -> bytes:
    out = io.BytesIO()
    pickler = _KeyPickler(out, protocol=5)
    pickler.fast = True  # without a memo: whether two equal strings are one object must not matter
    pickler.dump(parts)
    return out.getvalue()


def kept(make: Callable[..., T], *arguments: Any, **options: Any) -> T:
    """`make(*arguments, **options)`, from the cache if it is there. Arguments and result must be picklable.

    For functions without side effects whose result does not depend on what a test has patched.
    """
    name = f"{make.__module__}.{make.__qualname__}"
    said = _key_bytes(name, arguments, sorted(options.items()))
    folder = cache_folder()
    key = hashlib.sha256(code_version() + _sources_beside(make.__module__) + said).hexdigest()[:32]
    path = folder / f"{name.rpartition('.')[2]}-{key}"
    folder.mkdir(parents=True, exist_ok=True)
    with path.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if (data := _checked(path)) is None:
            data = pickle.dumps(make(*arguments, **options), protocol=5)
            _write(path, data)
            _forget_old(folder)
        else:
            with contextlib.suppress(FileNotFoundError):
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
    found = []
    for path in folder.iterdir():
        if "-" in path.name and not path.suffix:
            with contextlib.suppress(FileNotFoundError):  # another run's turn
                state = path.stat()
                found.append((state.st_mtime, state.st_size, path))
    total = 0
    for _, size, path in sorted(found, reverse=True):
        total += size
        if total > MAX_BYTES:
            path.unlink(missing_ok=True)
