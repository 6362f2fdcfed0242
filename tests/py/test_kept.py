"""What tests keep between runs is made once, and never taken where it is spoilt or of other code."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import kept as module
import pytest
from kept import kept

from ruffini.boards import find_board
from ruffini.sim.indenters import Indenter


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("RUFFINI_TEST_CACHE", str(tmp_path))
    return tmp_path


calls: list[float] = []


def square(x: float, *, sign: int = 1) -> float:
    calls.append(x)
    return sign * x * x


def files(folder: Path) -> list[Path]:
    return [p for p in folder.iterdir() if not p.suffix]


def test_it_is_made_once_for_each_argument(folder: Path) -> None:
    calls.clear()
    assert [kept(square, 3.0), kept(square, 3.0), kept(square, 2.0), kept(square, 3.0, sign=-1)] == [9, 9, 4, -9]
    assert calls == [3, 2, 3]
    assert len(files(folder)) == 3


def test_a_spoilt_file_is_made_again(folder: Path) -> None:
    kept(square, 5.0)
    calls.clear()
    (path,) = files(folder)
    path.write_bytes(path.read_bytes()[:-1] + b"x")
    assert kept(square, 5.0) == 25
    assert calls == [5]


def test_other_code_makes_its_own(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept(square, 7.0)
    calls.clear()
    monkeypatch.setattr(module, "code_version", lambda _: b"other")
    assert kept(square, 7.0) == 49
    assert calls == [7]


def test_the_code_of_what_is_given_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[str] = []
    monkeypatch.setattr(module, "code_version", lambda of: seen.append(of) or of.encode())
    kept(str, Indenter("sphere", 0.004))
    kept(str, find_board)
    kept(str, find_board("gelslim"))
    assert seen == [
        "builtins",
        "ruffini.sim.indenters",
        "builtins",
        "ruffini.boards",
        "builtins",
        "ruffini.boards.settings",
    ]


def test_what_a_module_imports_counts_and_nothing_else() -> None:
    """Directly, through another module, and in a function's body; packages on the way; of the tests what is in them."""

    def names(of: str) -> set[str]:
        return {str(path.relative_to(module.ROOT)) for path in module.sources(of)}

    contact = names("ruffini.sim.contact")
    assert "host/ruffini/sim/contact.py" in contact
    assert "host/ruffini/errors.py" in contact
    assert not any("/view/" in name or "/cli/" in name for name in contact)
    assert {"host/ruffini/sim/__init__.py", "host/ruffini/sim/pad.py"} <= contact
    assert {"tests/py/test_kept.py", "tests/support/kept.py", "host/ruffini/boards/settings.py"} <= names(__name__)
    assert len(names("of nobody")) == sum(len(list(one.rglob("*.py"))) for one in (module.PACKAGE, module.PAPERS))


def test_the_library_counts_for_those_that_load_it_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Boards are read by it: another one changes what `ruffini.boards` makes, and not a pad's compliance."""
    versions = []
    for content in (b"one", b"another"):
        (tmp_path / "libruffini.so").write_bytes(content)
        monkeypatch.setattr("ruffini.native.native_folder", lambda: tmp_path)
        versions.append([module.code_version.__wrapped__(of) for of in ("ruffini.sim.pad", "ruffini.boards", __name__)])
    assert [one == other for one, other in zip(*versions, strict=True)] == [True, False, False]


def test_a_module_that_imports_what_nobody_can_list_counts_as_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    everything = set(module.PACKAGE.rglob("*.py"))
    places = {"a": tmp_path / "a", "b": tmp_path / "b", "kept": Path(module.__file__).resolve()}
    monkeypatch.setattr(module, "_file_of", places.get)
    for line in ("import ruffini", "from ruffini import connect", "import subprocess", "importlib.import_module(x)"):
        (tmp_path / "a").write_text("def f():\n    import b\n")
        (tmp_path / "b").write_text(f"def f():\n    {line}\n")
        module._imports.cache_clear()
        assert everything < set(module.sources("a")), line
    (tmp_path / "b").write_text("from kept import kept\nfrom ruffini.errors import InputError\n")
    module._imports.cache_clear()
    assert set(module.sources("a")) == set(places.values())


def test_the_oldest_go(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept(square, 1.0)
    (first,) = files(folder)
    os.utime(first, (0, 0))
    monkeypatch.setattr(module, "MAX_BYTES", 2 * first.stat().st_size)
    kept(square, 2.0)
    kept(square, 3.0)
    assert len(files(folder)) == 2
    assert not first.exists()


KEEP_A_BOARD = """
from kept import kept
from ruffini.boards import find_board
kept(repr, find_board("gelslim"))
kept(repr, find_board("gelsight-mini"))
"""


def test_another_process_finds_a_boards_result(folder: Path) -> None:
    """Whatever the order of its sets, which the hash seed decides."""
    for seed in ("1", "2", "3"):
        path = os.pathsep.join(p for p in sys.path if p)
        environment = {**os.environ, "PYTHONHASHSEED": seed, "PYTHONPATH": path}
        subprocess.run([sys.executable, "-c", KEEP_A_BOARD], check=True, env=environment)
    assert len(files(folder)) == 2


def test_another_twin_in_a_boards_folder_makes_its_own(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    parent = tmp_path_factory.mktemp("boards")
    for place, more in (("a", ""), ("b", ""), ("c", "\n[mesh]\ncells_x = 10\ncells_y = 8\n")):
        shutil.copytree(find_board("gelslim").folder, parent / place / "gelslim")
        with (parent / place / "gelslim" / "twin.toml").open("a") as twin:
            twin.write(more)
        kept(repr, find_board(parent / place / "gelslim"))
    assert len(files(folder)) == 2
