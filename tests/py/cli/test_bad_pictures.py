"""Recordings that cannot be used, as typed: another size or pitch, no light, too much of it; said with the frame."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from small_board import Files, Run

Picture = npt.NDArray[np.uint8]
N = 14  # frames: base.toml learns rest from 8


def dots(seed: int, pitch: float = 15.0) -> Picture:
    """Grey with dots at base.toml's pitch of 15 px, the middle one at the picture's centre."""
    y, x = np.mgrid[:240, :320]
    away = np.hypot((x - 159.5 + pitch / 2) % pitch - pitch / 2, (y - 119.5 + pitch / 2) % pitch - pitch / 2)
    level = 130 - 80 / (1 + np.exp(2 * (away - 3)))
    noisy = level[..., None] + np.random.default_rng(seed).normal(0, 1, (240, 320, 3))
    return np.clip(np.round(noisy), 0, 255).astype(np.uint8)


def write(folder: Path, change: Callable[[Picture, int], Picture], pitch: float = 15.0) -> Path:
    folder.mkdir()
    for i in range(N):
        cv2.imwrite(str(folder / f"{i:03}.png"), change(dots(i, pitch), i))
    return folder


def late(change: Callable[[Picture], Picture]) -> Callable[[Picture, int], Picture]:
    return lambda picture, i: change(picture) if i >= 10 else picture


SPOILT = {
    "dark": (late(lambda p: np.zeros_like(p)), 15.0, {"dark": 10, "markers lost": 10}),
    "overexposed": (late(lambda p: np.clip(3.0 * p, 0, 255).astype(np.uint8)), 15.0, {"overexposed": 10}),
    "finer pitch": (lambda p, _: p, 11.5, {"not the board's pitch": 8}),
    "coarser pitch": (lambda p, _: p, 18.0, {"not the board's pitch": 8}),
    "half the pitch": (lambda p, _: p, 7.5, {"not the board's pitch": 8}),
    "sound": (lambda p, _: p, 15.0, {}),
}


@pytest.mark.parametrize("case", SPOILT)
def test_track_says_what_is_wrong_and_from_which_frame(case: str, files: Files, run: Run, tmp_path: Path) -> None:
    change, pitch, expected = SPOILT[case]
    log = write(tmp_path / "log", change, pitch)
    code, text, err = run("offline", "track", log, "--board", files.folder, "--json")
    assert code == 0, err
    result = json.loads(text)
    first = {word: row["first"] for word, row in result["faults"].items()}
    assert {word: first.get(word) for word in expected} == expected
    assert bool(first) == bool(expected)
    assert all(row["faults"] == [] for row in result["per_frame"][: min(expected.values(), default=N)])
    said = run("offline", "track", log, "--board", files.folder)[1]
    assert ("NOT TO BE USED" in said) == bool(expected)


def test_a_frame_of_another_size_is_named(files: Files, run: Run, tmp_path: Path) -> None:
    log = write(tmp_path / "log", lambda p, i: cv2.resize(p, (640, 480)) if i == 9 else p)
    for words in (("offline", "track", log), ("eval", "markers", log)):
        code, _, err = run(*words, "--board", files.folder)
        assert code == 2
        assert "frame 9 is 640x480, board 'small' needs 320x240" in err


def test_no_markers(files: Files, run: Run, tmp_path: Path) -> None:
    log = write(tmp_path / "log", lambda p, _: np.full_like(p, 120))
    for words in (("offline", "track", log), ("eval", "markers", log)):
        code, _, err = run(*words, "--board", files.folder)
        assert code == 2
        assert "no markers of board 'small'" in err


@pytest.mark.parametrize("pitch", [7.5, 11.5, 18.0, 30.0])
def test_eval_markers_judges_no_other_pad(pitch: float, files: Files, run: Run, tmp_path: Path) -> None:
    log = write(tmp_path / "log", lambda p, _: p, pitch)
    code, _, err = run("eval", "markers", log, "--board", files.folder, "--fields", "1")
    assert code == 2
    assert "is it the right board" in err


def test_eval_markers_survives_frames_without_light(files: Files, run: Run, tmp_path: Path) -> None:
    log = write(tmp_path / "log", late(lambda p: np.zeros_like(p)))
    code, text, err = run("eval", "markers", log, "--board", files.folder, "--fields", "1", "--json")
    assert code == 0, err
    assert json.loads(text)["rest"]["frames"] == 10
    assert set(json.loads(text)["lost"][10:]) == {json.loads(text)["markers_at_rest"]}


def test_depth_says_so_beside_its_numbers(files: Files, run: Run, tmp_path: Path) -> None:
    log = write(tmp_path / "log", late(lambda p: np.zeros_like(p)))
    words = ("depth", log / "009.png", log / "011.png", "--calibration", files.calibration, "--board", files.folder)
    code, text, err = run(*words, "--reference", log / "000.png")
    assert code == 0, err
    sound, dark = text.splitlines()
    assert "NOT TO BE USED" not in sound
    assert "NOT TO BE USED" in dark
    assert "dark" in dark
