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


def test_the_noise_of_first_touch_is_another_verb(run: Run, tmp_path: Path) -> None:
    code, _, err = run(
        "cal", "fit", "--only", "contact", tmp_path, "--board", "contact-glitter", "--out", tmp_path / "x"
    )
    assert code == 2
    assert "--log" in err or "unexpected" in err
