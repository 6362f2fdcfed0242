"""ruffini cal fit --only contact as typed, where there is nothing to fit."""

from __future__ import annotations

from pathlib import Path

import pytest
from small_board import Run


def test_a_folder_without_presses_is_refused(run: Run, tmp_path: Path) -> None:
    out = tmp_path / "contact.safetensors"
    code, _, err = run("cal", "fit", "--only", "contact", "--log", tmp_path, "--board", "contact-glitter", "--out", out)
    assert code == 2
    assert 'part "fit"' in err
    assert not out.exists()


def test_the_name_of_the_release_before_says_the_new_one_and_takes_the_same_way(run: Run, tmp_path: Path) -> None:
    words = ("--log", tmp_path, "--board", "contact-glitter", "--out", tmp_path / "x")
    old, new = run("cal", "contact", *words), run("cal", "fit", "--only", "contact", *words)
    assert "`cal contact` is now `ruffini cal fit --only contact`" in old[2]
    assert old[0] == new[0] == 2
    assert new[2] in old[2]


@pytest.mark.parametrize(
    ("words", "use"),
    [
        (("contact", "--report", "x.json"), "--report of `cal contact` is gone: `--json` prints the report"),
        (("skin", "--method", "taxels"), "--method of `cal skin` is gone: skins are fitted by taxels alone"),
        (("skin", "--most-n=9.4"), "--most-n of `cal skin` is gone: it was of --method paper"),
    ],
)
def test_an_option_that_is_gone_says_what_to_use(run: Run, tmp_path: Path, words: tuple[str, ...], use: str) -> None:
    code, _, err = run("cal", *words, "--presses", tmp_path, "--board", "eltac", "--out", tmp_path / "x")
    assert code == 2
    assert use in err


@pytest.mark.parametrize("only", [("--only", "fit*"), ("--only=fit*",)])
def test_the_pattern_of_a_fingertips_presses_has_its_old_name(run: Run, tmp_path: Path, only: tuple[str, ...]) -> None:
    (tmp_path / "judged" / "frames").mkdir(parents=True)
    words = ("--presses", tmp_path, "--board", "stereo-fingertip", "--baseline-mm", 4, "--out", tmp_path / "x")
    code, _, err = run("cal", "fingertip", *only, *words)
    assert code == 2
    assert "--only of `cal fingertip` is now --pattern" in err
    assert "`cal fingertip` is now `ruffini cal fit --only fingertip`" in err
    assert "there is no such stage" not in err
    assert (
        err.splitlines()[-1]
        == run("cal", "fit", "--only", "fingertip", "--pattern", "fit*", *words)[2].splitlines()[-1]
    )
