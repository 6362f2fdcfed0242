"""Every command that a README shows is one: its verbs, options, and in blocks also what a verb cannot do without."""

from __future__ import annotations

import argparse
import re
import runpy
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import NoReturn

import pytest
from hang import HANG_S
from readme_texts import BLOCK, NOT_COMMANDS, PROGRAM, ROOT, TEXTS, fault_of, name_of, spans, words_of

from ruffini.daemon import find_daemon

SCRIPT = re.compile(r"(?:python )?(tests/\S+\.py)( .*)?")


def lines(text: str) -> list[str]:
    """Of all blocks."""
    return [line.strip() for _, block in BLOCK.findall(text) for line in block.splitlines()]


def commands(text: str) -> Iterator[tuple[list[str], bool]]:
    """Words after the program's name, and whether they are a whole command."""
    for line in lines(text):
        if found := PROGRAM.match(line):
            yield words_of(found[1]), "..." not in line
    for span in spans(text):
        if (found := PROGRAM.fullmatch(span)) and found[1] not in NOT_COMMANDS:
            yield words_of(found[1]), False


@pytest.mark.parametrize("path", TEXTS, ids=name_of)
def test_commands_exist(path: Path) -> None:
    faults = [(words, fault_of(words, is_whole=whole)) for words, whole in commands(path.read_text())]
    assert [f for f in faults if f[1]] == []


def test_most_texts_have_some() -> None:
    found = [sum(1 for _ in commands(path.read_text())) for path in TEXTS]
    assert sum(n > 0 for n in found) > 15
    assert sum(found) > 150


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("cal coffee", "No such command"),
        ("cal operator --bored gelslim", "No such option"),
        ("cal fit --board tiny", "Missing"),
        ("record run.mcap --n many", "valid integer"),
        ("sim", "not a verb"),
    ],
)
def test_what_is_none_is_told(line: str, says: str) -> None:
    assert says in str(fault_of(line.split(), is_whole=True))


# ---- what is not the host tool -----------------------------------------------------------------------


class ParsedError(Exception):
    """The arguments are right: go no further."""


def scripts() -> list[tuple[str, list[str]]]:
    """Files of tests/ that a text names, with the words behind those that it has somebody run."""
    texts = [path.read_text() for path in TEXTS]
    shown = [s for text in texts for s in (*(re.sub(r" +#.*", "", line) for line in lines(text)), *spans(text))]
    found = [match for s in shown if (match := SCRIPT.fullmatch(s))]
    is_run = [match for match in found if match[0].startswith("python ") or match[2]]
    return sorted({(match[1], *shlex.split(match[2] or "")) for match in is_run if "*" not in match[1]})


@pytest.mark.parametrize("words", scripts(), ids=" ".join)
def test_a_script_takes_what_a_text_gives_it(words: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    parses(words, monkeypatch)


def test_a_script_has_its_own_neighbours(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another program's module of the same name may be loaded."""
    other = ModuleType("benchmarks")
    monkeypatch.setitem(sys.modules, "benchmarks", other)
    parses(("tests/bench/against_opencv.py", "--board", "ftouch"), monkeypatch)
    assert sys.modules["benchmarks"] is other


def parses(words: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    """Run a script until it has parsed its arguments."""
    parse = argparse.ArgumentParser.parse_args

    def stop(*arguments: object) -> NoReturn:
        parse(*arguments)
        raise ParsedError

    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", stop)
    monkeypatch.setattr("sys.argv", [words[0], *(word.strip("[]") for word in words[1:])])
    folder = (ROOT / words[0]).parent
    monkeypatch.syspath_prepend(str(folder))
    neighbours = {path.stem for path in folder.glob("*.py")}
    others = {name: sys.modules.pop(name) for name in neighbours & sys.modules.keys()}
    try:
        with pytest.raises(ParsedError):
            runpy.run_path(str(ROOT / words[0]), run_name="__main__")
    finally:
        for name in neighbours & sys.modules.keys():
            del sys.modules[name]
        sys.modules.update(others)


def test_files_of_tests_are_there() -> None:
    named = {match[1] for path in TEXTS for span in spans(path.read_text()) if (match := SCRIPT.fullmatch(span))}
    assert len(named) > 20
    assert [name for name in named if not list(ROOT.glob(name))] == []


def test_targets_and_variables_of_make_are_there() -> None:
    makefile = (ROOT / "Makefile").read_text()
    shown = [s for path in TEXTS for s in (*lines(path.read_text()), *spans(path.read_text()))]
    used = [words_of(s) for s in shown if s.startswith("make ")]
    targets = {word for words in used for word in words[1:] if "=" not in word}
    assert len(targets) > 10
    assert [t for t in targets if not re.search(rf"^{t}:.*##", makefile, re.M)] == []
    variables = {word.split("=")[0] for words in used for word in words[1:] if "=" in word}
    assert [v for v in variables if not re.search(rf"^{v} \?=", makefile, re.M)] == []


def test_options_of_the_daemon_are_there() -> None:
    usage = subprocess.run([find_daemon(), "--help"], capture_output=True, text=True, timeout=HANG_S, check=True).stdout
    shown = [s for path in TEXTS for s in (*lines(path.read_text()), *spans(path.read_text()))]
    options = {option for s in shown if s.startswith("ruffinid ") for option in re.findall(r"(?<= )--[a-z-]+", s)}
    assert len(options) > 5
    assert [option for option in options if not re.search(rf"{option}\b", usage)] == []
