"""The command line starts fast and is never silent: judged by the modules that it imports, not by a clock."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from hang import finished

from ruffini.cli.common import PLAIN_PERIOD_S, PlainProgress

# Third-party packages that help may import: Typer's own (it checks arguments with pydantic).
LIGHT = {"annotated_doc", "annotated_types", "attr", "click", "markdown_it", "mdurl", "pydantic", "pydantic_core",
         "pygments", "rich", "ruffini", "shellingham", "typer", "typing_extensions", "typing_inspection"}  # fmt: skip
IMPORTED_BY_HELP = """
import contextlib, io, sys
before = set(sys.modules)  # of the interpreter's start: sitecustomize and the like
from ruffini.cli import main
for words in {calls!r}:
    sys.argv = ["ruffini", *words, "--help"]
    with contextlib.redirect_stdout(io.StringIO()):
        assert main() == 0, words
    names = {{name.partition(".")[0] for name in set(sys.modules) - before}}
    heavy = sorted(name for name in names - set(sys.stdlib_module_names) - {light!r} if not name.startswith("_"))
    print(" ".join(words) or "ruffini", *heavy, sep=",")
"""
# Each line in a fork, which ends at its first heavy import: with 0 if something was printed before, else with 99.
FIRST_WORDS = """
import importlib.abc, os, sys

class Heavy(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name in ("numpy", "scipy", "cv2"):
            os._exit(0 if printed else 99)

class Watched:
    def __init__(self, stream): self.stream = stream
    def write(self, text):
        global printed
        printed = printed or bool(text.strip())
        return self.stream.write(text)
    def __getattr__(self, name): return getattr(self.stream, name)

printed = False
from ruffini.cli import main
import ruffini.cli.app
for line in sys.argv[1:]:
    child = os.fork()
    if child == 0:
        sys.argv = ["ruffini", *line.split()]
        sys.stderr, sys.stdout = Watched(sys.stderr), Watched(sys.stdout)
        sys.meta_path.insert(0, Heavy())
        main()
        os._exit(98)  # it ended without a heavy import
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), line, flush=True)
"""
HELP = [
    "",
    "devices",
    "view",
    "cal",
    "cal auto",
    "cal fit --only wrench",
    "sim press",
    "bench ifem",
    "eval photometric",
    "ros2 bridge",
]
LONG_VERBS = [
    "view --demo gelslim --no-browser --http-port 0", "cal auto --board gelslim --rig sim", "demo --board gelslim",
    "reproduce gelslim --out {out}", "reproduce ftouch --only recordings --out {out}",
    "sim press --board gelslim --out {out}", "bench mechanics", "bench ifem --board gelslim",
    "bench light --board gelslim", "reproduce gelslim --only method",
    "cal fit --only operator --board gelslim --out {out}",
    "cal fit {out} --board gelslim --out {out}", "cal fit --only photometric {out} --board gelslim --out {out}",
    "eval markers {out} --board gelslim", "offline track {out} --board gelslim",
]  # fmt: skip


def run(code: str, *words: str) -> subprocess.CompletedProcess[str]:
    return finished([sys.executable, "-c", code, *words])


def test_help_imports_nothing_heavy() -> None:
    """numpy alone takes longer than a help text may. The modules of all verbs are imported for each of them."""
    calls = [words.split() for words in HELP]
    done = run(IMPORTED_BY_HELP.format(calls=calls, light=LIGHT))
    assert done.returncode == 0, done.stderr
    rows = [row.split(",") for row in done.stdout.splitlines()]
    assert len(rows) == len(calls)
    assert [row for row in rows if len(row) > 1] == []


def test_a_long_verb_says_what_it_does_before_anything_heavy(tmp_path: Path) -> None:
    done = run(FIRST_WORDS, *[line.format(out=tmp_path) for line in LONG_VERBS])
    assert done.returncode == 0, done.stderr
    rows = done.stdout.splitlines()
    assert len(rows) == len(LONG_VERBS)
    assert [row for row in rows if not row.startswith("0 ")] == [], done.stderr


def test_progress_on_a_pipe_is_plain_lines(capsys: pytest.CaptureFixture[str]) -> None:
    now_s = 100.0
    progress = PlainProgress("pictures", lambda: now_s)
    assert capsys.readouterr().err == "pictures ...\n"
    for i in range(1, 11):
        now_s += PLAIN_PERIOD_S / 4
        progress.update(i / 10)
    assert capsys.readouterr().err == "pictures: 40 %, 5 s\npictures: 80 %, 10 s\n"
    progress.finish()
    assert capsys.readouterr().err == "pictures: done, 12 s\n"


def test_short_work_has_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    PlainProgress("pictures", lambda: 0.0).finish()
    assert capsys.readouterr().err == "pictures ...\n"
