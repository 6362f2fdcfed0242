"""How the fingertip's experiment judges: made-up presses whose errors are known."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest
from papers.experiments import Options
from papers.stereo_fingertip import experiment as stereo_pins
from papers.stereo_fingertip import limits as stereo_pins_limits
from papers.stereo_fingertip.experiment import AREA, FORCE, Played, X, figures, followed, is_whole

from ruffini.boards import find_board


def played(name: str = "any", tool: str = "flat", off: float = 0.1, sigma: float = 0.06, n: int = 20) -> Played:
    """Every quantity off by as much to both sides, the area in percent; the last frame is not told."""
    truth = np.column_stack([np.linspace(0.1, 1.0, n), *5 * [np.zeros(n)], np.full(n, 50.0)])
    sign = np.where(np.arange(n) % 2, 1.0, -1.0)[:, None]
    unit = np.where(np.arange(7) == AREA, 0.5, 1.0)
    known, whole = np.arange(n) < n - 1, np.arange(n) % 2 == 0
    ours = truth + off * sign * unit
    ours[-1] = 99.0
    return Played(name, tool, truth, ours, np.full((n, 7), sigma) * unit, known, whole, np.full(n, 2.0))


def test_errors_are_of_what_is_told_and_by_force() -> None:
    said = figures([played(), played(off=0.3)])
    assert said["n_frames"] == 40
    assert said["told_percent"] == pytest.approx(95)
    assert list(said["mean"].values()) == pytest.approx([0.2] * 7)
    assert said["stated"]["force_n"]["within_1"] == 0
    assert said["stated"]["force_n"]["within_2"] == pytest.approx(50)
    assert said["stated"]["area_percent"]["within_2"] == pytest.approx(50)
    assert set(said["by_force"]) == {"0.05-0.2", "0.2-0.4", "0.4-0.6", "0.6-0.8", "0.8-1.05"}
    assert said["sure_of_place"]["percent"] == pytest.approx(95)
    assert said["sure_of_place"]["x_mm"] == pytest.approx(0.2)
    one = played(sigma=2.0)
    one.ours[one.truth[:, FORCE] > 0.8, X] += 1.0
    levels = figures([one])["by_force"]
    assert levels["0.8-1.05"]["x_mm"] > 0.9
    assert levels["0.2-0.4"]["x_mm"] == pytest.approx(0.1)
    assert figures([one])["sure_of_place"]["percent"] == 0


def test_levels_are_of_full_scale() -> None:
    strong = played()
    strong.truth[:, FORCE] *= 10
    assert set(figures([strong], 10.0)["by_force"]) == {"0.5-2", "2-4", "4-6", "6-8", "8-10.5"}


def test_a_tool_that_is_followed_is_where_the_surest_frames_say() -> None:
    one = played(n=10)
    one.is_known[:] = True
    one.ours[:, X], one.sigma[:, X] = 3.0, 1.0
    one.ours[4, X], one.sigma[4, X] = 1.0, 0.01
    levels = followed([one])["x_mm"]
    assert levels["0.05-0.2"] == pytest.approx(3.0)
    assert levels["0.6-0.8"] == pytest.approx(1.0, abs=0.01)


def test_full_scale_error_is_the_largest_error_over_the_largest_force() -> None:
    """Equation (4) of the paper, of each test; then their mean."""
    tests = [played("test_force", off=0.1), played("test_force", off=0.02)]
    tests[0].ours[4, FORCE] = tests[0].truth[4, FORCE] - 0.3
    for one in tests:
        one.ours[-1] = one.truth[-1]
    said = stereo_pins._paper_tests(tests)
    assert said["full_scale_of_each_test"] == pytest.approx([30, 2])
    assert said["full-scale error"] == pytest.approx(16)
    assert said["force_of_each_test"] == pytest.approx([(18 * 0.1 + 0.3) / 20, 19 * 0.02 / 20])


def test_pictures_that_are_alike_bound_the_error_of_x() -> None:
    """Frame by frame: alike, two deviations apart, far apart; 3 mm has no pair."""
    one = np.zeros((3, 100))
    other = one.copy()
    other[1, :4], other[2, 0] = 0.01, 1.0
    least = stereo_pins_limits.least_mm({2.0: one, -2.0: other, 3.0: one}, 0.01)
    assert least == pytest.approx([2.0, 4 * 0.158655, 0.0], abs=1e-5)
    assert stereo_pins_limits.least_mm({3.0: one}, 0.01) == []


def test_areas_are_apart_by_tool_and_by_how_whole_a_contact_is() -> None:
    one, other = played(tool="flat", off=1.0), played(tool="square", off=3.0)
    one.ours[0, AREA] = 60.0  # 20 % off, whole
    found = stereo_pins._areas([one, other, played(name="shapes", tool="flat", off=50.0)])
    assert set(found) == {"flat", "square"}
    assert found["flat"]["n_whole"] == 10
    assert found["flat"]["whole"] == pytest.approx((20 + 9 * 1.0) / 10)
    assert found["square"]["whole"] == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("tool", "x_mm", "depth_mm", "whole"),
    [
        ("flat", 0.0, 0.56, False),  # 22 - sqrt(22^2 - 5^2) = 0.576
        ("flat", 0.0, 0.59, True),
        ("flat", 2.0, 1.13, False),  # the far side is 7 mm from the axis: 1.144
        ("flat", 2.0, 1.16, True),
        ("square", 0.0, 1.13, False),  # its corners are 7.07 mm away
        ("square", 0.0, 1.2, True),
        ("sphere", 0.0, 9.0, False),
    ],
)
def test_a_whole_face_is_below_the_undeformed_dome(tool: str, x_mm: float, depth_mm: float, *, whole: bool) -> None:
    assert is_whole(tool, 5.0, np.array([0.5, depth_mm, x_mm, 0, 0, 0, 0]), 22.0) == whole


def test_the_text_holds_every_table() -> None:
    runs = [played("any"), played("upright"), *(played(f"test_{k}") for k in ("force", "x", "y", "angle"))]
    result = {
        "board": "a board", "unseen": {"any": figures(runs[:1]), "shapes": figures([])},
        "one_eye": {"left": figures(runs[:1])}, "stand_in": {"1": {"force_n": 0.0123}},
        "paper_tests": stereo_pins._paper_tests(runs), "area": stereo_pins._areas(runs), "published": {"force": 0.777},
        "followed": {"any": followed(runs[:1]), "shapes": followed([])}, "frame_ms": stereo_pins._times(runs),
        "direct_area": [
            {"from_n": 0.05, "to_n": 0.2, "n": 3, "ours_mm2": 1, "true_mm2": 2, "mean_error_mm2": 1, "face_mm2": 5}
        ],
        "told_apart": {
            "force_n": [0.5], "noise_px": 0.0133, "deviations": {"X = 1 mm": [77.0]}, "least_mm": [0.3, 0.1],
        },
    }  # fmt: skip
    text = stereo_pins.text(result)
    for part in (
        "SIMULATED",
        "0.012",
        "0.0133",
        "full-scale error",
        "left eye alone",
        "0.777",
        "together 0.20",
        "Table A3",
        "Table 5",
    ):
        assert part in text, part
    assert "hexagon" not in text
    tests = stereo_pins._paper_tests(runs)
    assert tests["table_a1"][0]["error"][0] == pytest.approx(0.1)
    assert tests["table_a2"][0]["estimated"][1] == pytest.approx(tests["table_a2"][0]["true"] + 0.1)
    assert tests["force"] == pytest.approx((19 * 0.1 + 98.0) / 20)


class Reached(Exception):
    pass


def test_the_experiment_needs_no_pytorch(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A network of 50,000 products is fitted in numpy: 5 GB of PyTorch are for the paper's VGG16 alone."""

    def record(*_: object, **__: object) -> None:
        raise Reached

    monkeypatch.setitem(sys.modules, "torch", None)  # an import of it fails
    monkeypatch.setattr(stereo_pins, "record", record)
    with pytest.raises(Reached):
        stereo_pins.reproduce(find_board("stereo-fingertip"), tmp_path, Options(folder=tmp_path))


def test_only_the_verb_train_imports_pytorch() -> None:
    imports = re.compile(r"^\s*(import|from) torch\b", re.M)
    host = Path(stereo_pins.__file__).parents[2]
    found = {
        path.relative_to(host).as_posix() for path in host.rglob("*.py") if imports.search(path.read_text("utf-8"))
    }
    assert {name for name in found if not name.startswith("ruffini/train/")} == {"ruffini/cli/train.py"}
