"""The verbs that help shows, and the names of the release before."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any

import click.testing
import pytest
import typer
import typer.main
from typer.testing import CliRunner

from ruffini.cli import common
from ruffini.cli.app import app
from ruffini.cli.one_of import register

MOST_VERBS = 40


def leaves(command: Any) -> Iterator[Any]:
    if not command.hidden:
        children = getattr(command, "commands", None)
        yield from [command] if children is None else [leaf for one in children.values() for leaf in leaves(one)]


def test_help_shows_no_more_verbs_than_a_person_can_look_through() -> None:
    verbs = list(leaves(typer.main.get_command(app)))
    assert 30 < len(verbs) <= MOST_VERBS
    assert all(verb.help for verb in verbs)


def test_help_groups_the_verbs() -> None:
    said = CliRunner().invoke(app, ["--help"]).output
    assert [
        panel for panel in ("Use", "Calibrate", "Judge", "Simulate", "Maintain") if f"─ {panel} ─" not in said
    ] == []


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("cal show FILE", "cal file show"),
        ("cal wrench FILE", "cal fit --only wrench"),
        ("field --calibration FILE --displacement FILE --out FILE", "offline field"),
        ("bench papers --recordings FILE", "reproduce BOARD --only method"),
    ],
)
def test_an_old_name_works_and_prints_the_new_one(old: str, new: str, tmp_path: Any) -> None:
    words = old.replace("FILE", str(tmp_path / "nothing")).split()
    done = CliRunner().invoke(app, words)
    assert f"is now `ruffini {new}`" in done.stderr
    assert done.exit_code not in (0, 2), done.output  # it goes on, to a file that is not there


def test_a_verb_of_several_refuses_what_the_chosen_one_does_not_take() -> None:
    for words, reason in (
        (["bench", "held", "--board", "gelslim", "--quick"], "has no option --quick"),
        (["board", "list", "gelslim"], "nothing takes 'gelslim'"),
        (["board", "nothing"], "choose one of check, show, list, eeprom"),
        (["bench", "held"], "Missing option '--board'"),
        (["key", "sign"], "Missing argument 'FILE'"),
    ):
        done = CliRunner().invoke(app, words, env={"COLUMNS": "200", "TERMINAL_WIDTH": "200"})
        assert done.exit_code == 2
        assert reason in done.stderr


def test_only_takes_the_options_of_the_stage() -> None:
    for words in (["--only", "operator"], ["--only=operator"]):
        said = CliRunner().invoke(app, ["cal", "fit", *words, "--help"]).output
        assert "--noise-um" in said
    said = CliRunner().invoke(app, ["cal", "fit", "--only", "noise", "--help"]).output
    assert "--skip" in said


def test_what_one_call_needs_the_next_one_does_not() -> None:
    own = typer.Typer()
    own.command("other")(lambda: None)
    seen: list[str] = []

    def strict(board: Annotated[str, typer.Option("--board")]) -> None:
        seen.append(board)

    def easy() -> None:
        seen.append("easy")

    register(own, "verb", "Two.", {"strict": strict, "easy": easy})
    command, runner = typer.main.get_command(own), click.testing.CliRunner()
    missing = runner.invoke(command, ["verb", "strict"])
    assert missing.exit_code == 2
    assert "board" in missing.output
    assert runner.invoke(command, ["verb", "easy"]).exit_code == 0
    assert seen == ["easy"]


@pytest.mark.parametrize(("asked", "n_cores", "n"), [(3, 64, 3), (20, 2, 20), (None, 2, 2), (None, 64, 8)])
def test_workers_are_as_many_as_asked_or_one_a_core_up_to_eight(monkeypatch, asked, n_cores, n):
    monkeypatch.setattr(common.os, "sched_getaffinity", lambda _: set(range(n_cores)), raising=False)
    assert common.n_workers_of(asked) == n
