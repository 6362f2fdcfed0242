"""Colour -> slope from ball presses: recovers slopes that a drawn pad has, and names what is wrong with a folder."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from kept import kept

from ruffini.boards import find_board
from ruffini.calibrate.fit.job import Job
from ruffini.errors import InputError
from ruffini.estimators.photometric.fit import (
    Choice,
    best_choice,
    collect_samples,
    fit_photometric,
    simplest_good,
    tabulate,
)
from ruffini.estimators.photometric.presses import load_presses
from ruffini.estimators.photometric.stage import PHOTOMETRIC

BALL_MM, PX_PER_MM = 5.0, 15.0
SHAPE = (120, 160)
LAMPS = np.array([[0.5, 0.1], [-0.2, 0.45], [-0.25, -0.5]])  # relative change of B, G, R per unit normal x, y


def draw(rng: np.random.Generator, circle: tuple[float, float, float] | None) -> np.ndarray:
    """A ball's cap seen from straight below; light Lambertian in the normal's x and y."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    normal = np.zeros((*SHAPE, 2))
    if circle is not None:
        radius = BALL_MM / 2 * PX_PER_MM
        dx, dy = x - circle[0], y - circle[1]
        inside = np.hypot(dx, dy) < circle[2]
        normal[inside] = np.stack([dx, dy], axis=-1)[inside] / radius
    level = 120 * (1 + normal @ LAMPS.T) + rng.normal(0, 1, (*SHAPE, 3))
    return np.clip(np.round(level), 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("presses")
    rng = np.random.default_rng(3)
    for i in range(4):
        cv2.imwrite(str(root / f"reference_{i}.png"), draw(rng, None))
    lines = ["image,center_x_px,center_y_px,contact_radius_px"]
    for i in range(12):
        circle = (rng.uniform(45, 115), rng.uniform(40, 80), rng.uniform(14, 24))
        cv2.imwrite(str(root / f"{i}.png"), draw(rng, circle))
        lines.append(f"{i}.png,{circle[0]:.2f},{circle[1]:.2f},{circle[2]:.2f}")
    (root / "presses.csv").write_text("\n".join(lines) + "\n")
    (root / "presses.toml").write_text(f"ball_mm = {BALL_MM}\npx_per_mm = {PX_PER_MM}\n")
    return root


def test_presses_left_out_are_predicted(folder: Path) -> None:
    fit = kept(fit_photometric, collect_samples(load_presses(folder), None))
    report = fit.report()
    assert report["n_presses"] == 12
    assert report["held_out_normal_median_deg"] < 2
    assert report["held_out_normal_worst_deg"] < 5
    tables = tabulate(fit.model)
    assert tables["photometric.unmix"].dtype == np.int16
    assert tables["photometric.slope"].dtype == np.int16


def test_a_correction_must_be_demanded_by_the_presses() -> None:
    noise = np.random.default_rng(1).normal(0, 0.3, (3, 32))
    plain, corrected, coarse = 2.40 + noise[0], 2.38 + noise[1], 2.90 + noise[2]
    assert simplest_good(np.stack([coarse, plain, corrected]), [6, 18, 36]) == 1  # 0.02 better is no better
    assert simplest_good(np.stack([coarse, plain + 0.5, corrected]), [6, 18, 36]) == 2


def test_a_lattice_must_take_off_a_tenth_of_the_error() -> None:
    plain, bent = Choice(1, None), Choice(1, 1e-4)
    assert best_choice({plain: np.full(32, 2.24), bent: np.full(32, 2.17)}) == plain
    assert best_choice({plain: np.full(32, 6.69), bent: np.full(32, 4.12)}) == bent


def test_lambertian_light_is_fitted_without_a_correction(folder: Path) -> None:
    fit = kept(fit_photometric, collect_samples(load_presses(folder), None))
    choice = fit.model.choice
    assert (choice.unmix_order, choice.stiffness, choice.is_balanced) == (0, None, False)


BAD = {
    "no such folder": (lambda f: f.rename(f.with_name("gone")), "not a folder"),
    "no reference": (lambda f: [p.unlink() for p in f.glob("reference*")], "reference.png"),
    "no table": (lambda f: (f / "presses.csv").unlink(), "presses.csv is missing"),
    "no scale": (lambda f: (f / "presses.toml").unlink(), "--ball-mm"),
    "broken scale": (lambda f: (f / "presses.toml").write_text("ball_mm = ="), "presses.toml"),
    "negative ball": (lambda f: (f / "presses.toml").write_text("ball_mm = -1\npx_per_mm = 5"), "positive"),
    "column missing": (lambda f: (f / "presses.csv").write_text("image,center_x_px\n0.png,5\n"), "lacks the columns"),
    "image missing": (lambda f: (f / "3.png").unlink(), "no image '3.png'"),
    "number broken": (
        lambda f: (f / "presses.csv").write_text((f / "presses.csv").read_text().replace("0.png,", "0.png,x")),
        "row 1",
    ),
    "radius not a number": (
        lambda f: (f / "presses.csv").write_text(
            "image,center_x_px,center_y_px,contact_radius_px\n" + 3 * "0.png,50,50,nan\n"
        ),
        "not finite",
    ),
    "two presses": (
        lambda f: (f / "presses.csv").write_text("".join((f / "presses.csv").read_text().splitlines(True)[:3])),
        "at least 3",
    ),
    "table is binary": (lambda f: (f / "presses.csv").write_bytes(b"\xff\xfe\x00"), "presses.csv"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD, ids=str)
def test_what_is_wrong_is_named(case: str, folder: Path, tmp_path: Path) -> None:
    import shutil

    copy = tmp_path / "presses"
    shutil.copytree(folder, copy)
    change, words = BAD[case]
    change(copy)
    with pytest.raises(InputError, match=words.replace("(", r"\(")):
        collect_samples(load_presses(copy), None)


def test_a_bad_marked_press_is_skipped_with_its_reason(folder: Path, tmp_path: Path) -> None:
    import shutil

    copy = tmp_path / "presses"
    shutil.copytree(folder, copy)
    cv2.imwrite(str(copy / "0.png"), np.full((50, 50, 3), 90, np.uint8))
    (copy / "1.png").write_text("no picture")
    presses = load_presses(copy)
    assert [s.path.name for s in presses.skipped] == ["0.png", "1.png"]
    assert "50x50" in presses.skipped[0].reason
    assert "cannot read" in presses.skipped[1].reason
    assert len(collect_samples(presses, None)) == len(load_presses(folder).presses) - 2
    with pytest.raises(InputError, match=r"usable presses: at least 100 are needed; 0\.png: the picture is 50x50"):
        load_presses(copy, at_least=100)


def test_pictures_of_presses_that_give_no_colours_leave_depth_open_where_force_needs_none(monkeypatch) -> None:
    def refused(*_: object) -> None:
        raise InputError("no circle")

    monkeypatch.setattr("ruffini.estimators.photometric.stage._presses", refused)
    made = PHOTOMETRIC.fit(Job(find_board("ninedtact"), []), lambda _: None)
    assert made.state == "open"
    assert "the log's presses give none: no circle" in made.text
    with pytest.raises(InputError, match="no circle"):
        PHOTOMETRIC.fit(Job(find_board("gelslim"), []), lambda _: None)
    with pytest.raises(InputError, match="no circle"):  # given for that alone
        PHOTOMETRIC.fit(Job(find_board("ninedtact"), [], balls=Path("balls")), lambda _: None)
