"""Results that are expensive and always the same, kept between runs and shared between the workers of one run.

A result is found again by the hash of the function's name, its arguments and the code version: the interpreter, numpy,
scipy, the project's sources that the module of the function, or of an argument's class, imports, directly or not, and
the native library with the boards that it reads, where one of those loads it. One worker makes it, the others wait for
it. A file whose checksum does not fit is made again. RUFFINI_TEST_CACHE names the folder; an empty one costs time only.
"""

from __future__ import annotations

import ast
import contextlib
import fcntl
import functools
import hashlib
import importlib.util
import io
import os
import pickle
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FunctionType
from typing import Any, TypeVar

from pydantic import BaseModel

import ruffini

T = TypeVar("T")

ROOT = Path(__file__).resolve().parents[2]
TESTS, PACKAGE = ROOT / "tests", Path(ruffini.__file__).resolve().parent
PAPERS = PACKAGE.parent / "papers"
SHA_BYTES = 32
MAX_BYTES = 4 << 30  # of four versions of the code; the least recently used go first. An operator takes up to 210 MB


def cache_folder() -> Path:
    """The folder of everything that tests keep between runs."""
    base = os.environ.get("RUFFINI_TEST_CACHE")
    if base:
        return Path(base)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "ruffini" / "tests"


@functools.cache
def code_version(module: str) -> bytes:
    """Hash of all that a result of this module's functions may depend on beside their arguments."""
    import numpy
    import scipy

    from ruffini.native import native_folder

    found = hashlib.sha256(f"{sys.version} {numpy.__version__} {scipy.__version__}".encode())
    paths = sources(module)
    if PACKAGE / "native.py" in paths:  # only through it is the library loaded, and only the library reads a board
        paths += [*sorted((ROOT / "boards").rglob("*.toml")), native_folder() / "libruffini.so"]
    for path in paths:
        found.update(str(path.name).encode() + b"\0" + path.read_bytes())
    return found.digest()


def sources(module: str) -> list[Path]:
    """The project's sources that a module imports, directly or not, wherever the import stands; its own among them.

    All of the host package where one of them imports by a name made at run time or starts a process, and where the
    module's own source is not known.
    """
    found = set() if _file_of(module) else _every_source()
    to_read = [_file_of(module)]
    while to_read:
        path = to_read.pop()
        if path is None or path in found:
            continue
        found.add(path)
        names, is_open_ended = _imports(path)
        if is_open_ended:
            found.update(_every_source())
        to_read += [_file_of(name) for name in names]
    return sorted(found)


def _every_source() -> set[Path]:
    return {*PACKAGE.rglob("*.py"), *PAPERS.rglob("*.py")}


@functools.cache
def _file_of(module: str) -> Path | None:
    """A module's source, where it is one of the project's."""
    if module.partition(".")[0] in (PACKAGE.name, PAPERS.name):
        path = PACKAGE.parent.joinpath(*module.split("."))
        return next((p for p in (path.with_suffix(".py"), path / "__init__.py") if p.is_file()), None)
    loaded = sys.modules.get(module)
    with contextlib.suppress(ValueError, ModuleNotFoundError):
        spec = None if loaded or "." in module else importlib.util.find_spec(module)
        origin = getattr(loaded, "__file__", None) or (spec and spec.origin)
        if origin and TESTS in (path := Path(origin).resolve()).parents:
            return path
    return None


@functools.cache
def _imports(path: Path) -> tuple[set[str], bool]:
    """What a source imports, with the packages that this imports; and whether that may not be all."""
    # The one imports the API when somebody asks for that; what this file imports makes no result.
    if path in (PACKAGE / "__init__.py", Path(__file__).resolve()):
        return set(), False
    names: set[str] = set()
    text = path.read_text()
    for node in _statements(ast.parse(text).body):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.update([node.module, *(f"{node.module}.{alias.name}" for alias in node.names)])
    asks_for_api = PACKAGE.name in names and any(f"{PACKAGE.name}.{name}" in names for name in ruffini.__all__)
    is_open_ended = (
        asks_for_api or re.search(r"import_module|subprocess|^ *import ruffini$", text, re.MULTILINE) is not None
    )
    packages = {name.rsplit(".", n)[0] for name in names for n in range(1, name.count(".") + 1)}
    return names | packages, is_open_ended


def _statements(body: list[ast.stmt]) -> Iterator[ast.stmt]:
    """All statements, those within others too; no expressions, which are most of a syntax tree."""
    for node in body:
        yield node
        for name in ("body", "orelse", "finalbody"):
            yield from _statements(getattr(node, name, []))
        for part in [*getattr(node, "handlers", []), *getattr(node, "cases", [])]:
            yield from _statements(part.body)


class _KeyPickler(pickle.Pickler):
    """Equal arguments give equal bytes in every process; collects the modules of their classes and functions."""

    def __init__(self, out: io.BytesIO) -> None:
        super().__init__(out, protocol=5)
        self.fast = True  # without a memo: whether two equal strings are one object must not matter
        self.modules: set[str] = set()

    def reducer_override(self, value: object) -> Any:
        """A pydantic model by its fields and private attributes; it also holds sets, ordered by the hash seed.

        A board's folder counts by its content: the twin's settings are in it, and tests copy it to temporary folders.
        """
        if isinstance(value, type | FunctionType):
            self.modules.add(value.__module__)
        if isinstance(value, BaseModel):
            self.modules.add(type(value).__module__)
            others = {name: said for name, said in vars(value).items() if name not in type(value).model_fields}
            private = sorted({**(value.__pydantic_private__ or {}), **others}.items())
            return tuple, ([type(value).__qualname__, value.model_dump_json(), private],)
        if isinstance(value, Path) and value.is_dir():
            files = [path for path in sorted(value.rglob("*")) if path.is_file()]
            return tuple, ([(str(p.relative_to(value)), hashlib.sha256(p.read_bytes()).digest()) for p in files],)
        return NotImplemented


def _key_bytes(*parts: object) -> tuple[bytes, set[str]]:
    """The parts as bytes, and the project's modules that their classes and functions are of."""
    out = io.BytesIO()
    pickler = _KeyPickler(out)
    pickler.dump(parts)
    return out.getvalue(), {module for module in pickler.modules if _file_of(module)}


def kept(make: Callable[..., T], *arguments: Any, **options: Any) -> T:
    """`make(*arguments, **options)`, from the cache if it is there. Arguments and result must be picklable.

    For functions without side effects whose result does not depend on what a test has patched.
    """
    name = f"{make.__module__}.{make.__qualname__}"
    said, modules = _key_bytes(name, arguments, sorted(options.items()))
    code = b"".join(code_version(module) for module in sorted(modules | {make.__module__}))
    folder = cache_folder()
    key = hashlib.sha256(code + said).hexdigest()[:32]
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
