"""Brightness -> depth of drawn skins that darken: the table, contacts that are found, what cannot be one."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from typer.testing import CliRunner

from ruffini.boards import find_board
from ruffini.cli.app import app
from ruffini.errors import InputError
from ruffini.estimators.photometric.change import Rest
from ruffini.estimators.photometric.find_discs import is_monochrome
from ruffini.estimators.photometric.fitted import fit_presses
from ruffini.estimators.photometric.intensity import IntensityFit, fit_intensity
from ruffini.estimators.photometric.presses import load_presses

BOARD = find_board(Path(__file__).parents[3] / "boards" / "gelsight-mini")
BALL_MM, PX_PER_MM = 6.0, 12.0
SHAPE = (160, 200)
Picture = npt.NDArray[np.uint8]


def draw(rng: np.random.Generator, circle: tuple[float, float, float] | None, tint: float = 0.0) -> Picture:
    """d = -0.25 z - 0.05 z^2 of the depth z in millimetres; a ring round the contact gets brighter."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    light = np.ones(SHAPE)
    if circle is not None:
        away = np.hypot(x - circle[0], y - circle[1])
        ball = BALL_MM / 2 * PX_PER_MM
        depth = (np.sqrt(np.maximum(ball**2 - away**2, 0)) - np.sqrt(ball**2 - circle[2] ** 2)) / PX_PER_MM
        outside = 0.06 * np.exp(-(((away - circle[2] - 8) / 6) ** 2))
        light += np.where(away < circle[2], -0.25 * depth - 0.05 * depth**2, outside)
    level = 150 * np.stack([light, 1 + (light - 1) * (1 - tint), 1 + (light - 1) * (1 - 2 * tint)], axis=-1)
    return np.asarray(np.clip(np.round(level + rng.normal(0, 1, level.shape)), 0, 255), np.uint8)


CIRCLES = [(80.3, 75.6, 24.0), (110.0, 90.0, 20.0), (95.0, 60.5, 26.0)]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    rng = np.random.default_rng(2)
    root = tmp_path / "dark"
    (root / "press").mkdir(parents=True)
    cv2.imwrite(str(root / "reference.png"), draw(rng, None))
    for i, circle in enumerate(CIRCLES):
        cv2.imwrite(str(root / "press" / f"{i}.png"), draw(rng, circle))
    (root / "presses.toml").write_text(f"ball_mm = {BALL_MM}\npx_per_mm = {PX_PER_MM}\n")
    return root


def test_contacts_are_found_and_the_depth_is_the_drawn_one(folder: Path) -> None:
    presses = load_presses(folder, may_find=True, at_least=1)
    assert presses.is_found
    for press, (x, y, radius) in zip(presses.presses, CIRCLES, strict=True):
        assert (press.center_x_px, press.center_y_px) == pytest.approx((x, y), abs=0.5)
        assert press.radius_px == pytest.approx(radius, abs=1.5)
    fit = fit_presses(presses, BOARD, is_foreign=True)
    assert isinstance(fit.kind, IntensityFit)
    assert fit.report["source"] == "intensity"
    assert fit.report["held_out_cap_rms_mm"] < 0.02
    table = fit.tensors["photometric.depth"]
    assert table.dtype == np.int16
    depth_mm = np.array([0.2, 0.5, 0.8])
    change = -0.25 * depth_mm - 0.05 * depth_mm**2
    found = np.interp(change, np.linspace(-1, 1, 257), table / 8e3)
    assert found == pytest.approx(-depth_mm, abs=0.06)
    assert not table[128:].any()  # as it was, and brighter: no depth


def test_one_press_is_enough_and_says_that_none_was_left_out(folder: Path) -> None:
    for i in (1, 2):
        (folder / "press" / f"{i}.png").unlink()
    fit = fit_intensity(load_presses(folder, may_find=True, at_least=1))
    assert fit.report()["held_out_cap_rms_mm"] is None
    assert fit.report()["fitted_cap_rms_mm"] < 0.02


def test_the_verbs_fit_judge_and_report(folder: Path, tmp_path: Path) -> None:
    out, page = tmp_path / "dark.safetensors", tmp_path / "page.html"
    words = [
        "cal",
        "fit",
        "--only",
        "photometric",
        str(folder),
        "--board",
        str(BOARD.folder),
        "--foreign",
        "--out",
        str(out),
    ]
    done = CliRunner().invoke(app, [*words, "--report", str(page), "--json"])
    assert done.exit_code == 0, done.output
    report = json.loads(page.with_suffix(".json").read_text())
    assert report["source"] == "intensity"
    assert len(report["presses"]) == 3
    assert report["refitted"]["cap_worst_mm"] < 0.03
    text = page.read_text()
    assert text.count("data:image/png;base64,") == 2
    assert 'src="http' not in text
    judge = ["eval", "photometric", str(folder), "--calibration", str(out), "--board", str(BOARD.folder)]
    judged = json.loads(CliRunner().invoke(app, [*judge, "--json"]).stdout)
    assert judged["circles"] == "found"
    for row in judged["presses"]:
        assert row["marked"]["peak_mm"] == pytest.approx(row["marked"]["ball_peak_mm"], abs=0.1)
        assert row["marked"]["normal_deg"] < 4


def test_depth_of_a_picture_that_is_not_of_the_boards_size(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "dark.safetensors"
    board = ["--board", str(BOARD.folder)]
    done = CliRunner().invoke(
        app, ["cal", "fit", "--only", "photometric", str(folder), *board, "--foreign", "--out", str(out)]
    )
    assert done.exit_code == 0, done.output
    words = ["offline", "depth", str(folder / "press" / "0.png"), "--calibration", str(out), *board]
    assert "--px-per-mm" in str(CliRunner().invoke(app, words).exception)
    scale = ["--px-per-mm", str(PX_PER_MM)]
    done = CliRunner().invoke(app, [*words, *scale, "--out", str(tmp_path / "depth"), "--json"])
    assert done.exit_code == 0, done.output
    depth_mm = np.load(tmp_path / "depth" / "0.npy") * 1e3
    ball = BALL_MM / 2 * PX_PER_MM
    deepest_mm = (ball - np.sqrt(ball**2 - CIRCLES[0][2] ** 2)) / PX_PER_MM
    assert depth_mm.shape == SHAPE
    assert -depth_mm[75, 80] == pytest.approx(deepest_mm, abs=0.08)
    assert np.abs(depth_mm[:20]).max() < 0.1


def test_colours_that_change_apart_are_not_one_colour() -> None:
    rng = np.random.default_rng(4)
    rest = draw(rng, None).astype(float)
    for tint, is_one_colour in ((0.0, True), (0.1, True), (0.8, False)):
        assert is_monochrome([Rest(rest).change(draw(rng, CIRCLES[0], tint=tint).astype(float))]) is is_one_colour


def test_what_is_no_press_is_told(folder: Path) -> None:
    rng = np.random.default_rng(5)
    cv2.imwrite(str(folder / "press" / "1.png"), draw(rng, None))
    found = load_presses(folder, may_find=True, at_least=1)
    assert [(s.path.name, s.reason[:14]) for s in found.skipped] == [("1.png", "ball not found")]
    assert [p.path.name for p in found.presses] == ["0.png", "2.png"]
    with pytest.raises(InputError, match=r"2 usable presses: at least 3 are needed; 1.png: ball not found"):
        load_presses(folder, may_find=True)
    with pytest.raises(InputError, match="--source 'grey'"):
        fit_presses(load_presses(folder, may_find=True, at_least=1, truth=_truth(folder)), BOARD, is_foreign=True,
                    source="grey")  # fmt: skip


def _truth(folder: Path) -> Path:
    path = folder / "circles.csv"
    path.write_text("image,center_x_px,center_y_px,contact_radius_px\n0.png,80,76,24\n")
    return path
