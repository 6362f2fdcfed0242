"""ruffini cal fit --only contact as typed, where there is nothing to fit."""

from __future__ import annotations

from pathlib import Path

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
