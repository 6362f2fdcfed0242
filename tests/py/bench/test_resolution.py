"""The bench of resolution: fields whose blur is known, a truth that others know, and the rows that are printed."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from scipy.ndimage import gaussian_filter1d
from typer.testing import CliRunner

from ruffini.bench import resolution
from ruffini.boards import find_board
from ruffini.cli.app import app
from ruffini.errors import InputError
from ruffini.fem.layer import layer_compliance

ROOT = Path(__file__).parents[3]
sys.path.append(str(ROOT / "tests" / "bench"))

import gels  # noqa: E402
import resolution as command  # noqa: E402

Array = npt.NDArray[np.float64]
NODES_MM = np.arange(-8, 8.01, 0.5)
SIGMA_MM = 0.4
FINE_MM = 0.01
# exp(-2 (pi sigma f)^2) = 1 / 2; and 2 exp(-d^2 / (8 sigma^2)) = (1 - 0.265) (1 + exp(-d^2 / (2 sigma^2))).
HALF_PER_MM = 0.1874 / SIGMA_MM
APART_MM = 2.80 * SIGMA_MM


def moved_waves(frequency: float, sigma_mm: float, phases: int = 5) -> Array:
    """1 + cos at each phase, blurred on a fine line and then sampled at the nodes."""
    fine = np.arange(-12, 12 + FINE_MM / 2, FINE_MM)
    phase = 2 * np.pi * np.arange(phases)[:, None] / phases
    field = 1 + np.cos(2 * np.pi * frequency * fine + phase)
    if sigma_mm:
        field = gaussian_filter1d(field, sigma_mm / FINE_MM, axis=1)
    return np.array([np.interp(NODES_MM, fine, row) for row in field])


def wave(frequency: float) -> npt.NDArray[np.complex128]:
    return np.exp(2j * np.pi * frequency * NODES_MM)


@pytest.mark.parametrize("frequency", [0.05, 0.4, 1.0, 1.3])  # the nodes' own limit is 1
def test_an_ideal_field_has_response_1(frequency: float) -> None:
    assert resolution.response(moved_waves(frequency, 0), wave(frequency)) == pytest.approx(1, abs=1e-3)


def test_a_field_that_is_half_as_strong_shifted_or_elsewhere_has_less() -> None:
    field = moved_waves(0.4, 0)
    assert resolution.response(0.5 * field, wave(0.4)) == pytest.approx(0.5, abs=1e-3)
    assert resolution.response(np.roll(field, 1, axis=0), wave(0.4)) == pytest.approx(np.cos(0.4 * np.pi), abs=1e-3)
    assert resolution.response(np.ones_like(field), wave(0.4)) == pytest.approx(0)
    noise = np.random.default_rng(0).normal(size=(400, *field.shape))
    responses = [resolution.response(one, wave(0.4)) for one in noise]
    assert abs(np.mean(responses)) < 3 * np.std(responses) / 20


def test_a_gaussian_blur_falls_to_half_where_it_is_known_to() -> None:
    frequency = np.arange(0.1, 1.2, 0.02)
    curve = np.array([resolution.response(moved_waves(f, SIGMA_MM), wave(f)) for f in frequency])
    assert resolution.falls_to(frequency, curve) == pytest.approx(HALF_PER_MM, rel=0.01)
    assert resolution.falls_to(frequency[:5], curve[:5]) is None


def test_half_is_looked_for_beyond_the_peak() -> None:
    assert resolution.falls_to(np.arange(5.0), np.array([0.2, 0.6, 1.0, 0.7, 0.3])) == pytest.approx(3.5)


def test_a_gaussian_blur_tells_lines_apart_from_its_known_distance_on() -> None:
    fine = np.arange(-6, 6 + FINE_MM / 2, FINE_MM)
    distance = np.arange(0.9, 1.4, 0.01)

    def field(d: float) -> Array:
        return np.asarray(sum(np.exp(-((fine - at) ** 2) / (2 * SIGMA_MM**2)) for at in (-d / 2, d / 2)))

    share = np.array([float(resolution.are_apart(field(d), fine, (-d / 2, d / 2))) for d in distance])
    assert resolution.smallest_distance(distance, share) == pytest.approx(APART_MM, abs=0.015)


def test_one_line_and_noise_beside_it_are_not_two() -> None:
    place = np.arange(-4.0, 5.0)
    one = np.array([0, 0.3, 0, 0, 5.0, 4.9, 0, 0, 0])
    assert not resolution.are_apart(one, place, (-0.5, 0.5))
    assert not resolution.are_apart(np.array([0, 3.0, 0, 0, 0, 5.0, 0, 0, 0]), place, (-1.0, 1.0))
    assert resolution.are_apart(np.array([0, 0, 0, 3.0, 0, 5.0, 0, 0, 0]), place, (-1.0, 1.0))
    assert not resolution.are_apart(np.array([0, 0, 0, -3.0, -9.0, 5.0, 0, 0, 0]), place, (-1.0, 1.0))


def test_a_distance_counts_where_all_larger_ones_and_all_places_do() -> None:
    distance = np.array([1.0, 2.0, 3.0, 4.0])
    assert resolution.smallest_distance(distance, np.array([[1, 1], [1, 0.9], [1, 0.95], [1, 1]])) == 3
    assert resolution.smallest_distance(distance, np.array([1, 1, 1, 0.9])) is None
    assert resolution.smallest_distance(distance, np.ones((4, 2, 2))) == 1


@pytest.fixture(scope="module")
def coarse(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A gelslim with half of its nodes along each way: seconds instead of minutes."""
    source, folder = ROOT / "boards" / "gelslim", tmp_path_factory.mktemp("coarse") / "gelslim"
    folder.mkdir()
    text = (source / "board.toml").read_text()
    assert "n_x = 31\nn_y = 25\n" in text
    (folder / "board.toml").write_text(text.replace("n_x = 31\nn_y = 25\n", "n_x = 16\nn_y = 13\n"))
    (folder / "twin.toml").write_bytes((source / "twin.toml").read_bytes())
    return folder


@pytest.mark.parametrize("axis", [0, 1])
def test_the_truth_is_the_exact_layers_and_carries_its_load(coarse: Path, axis: int) -> None:
    """In the middle of the pad; `layer_compliance` has no mesh."""
    board = find_board(str(coarse))
    truth = resolution.make_truth(board, axis)
    two = resolution.line(truth.across_mm, truth.area_m2, -0.7, 0.5) + resolution.line(
        truth.across_mm, truth.area_m2, 1.1, 0.5
    )
    force = truth.state(two).force.sum(axis=(0, 1))
    np.testing.assert_allclose(force, [0, 0, -1], atol=1e-9)
    per_mm, k = 0.25, 2 * np.pi * 250.0
    half_mm = 1e3 * resolution.half_window_m(board)[axis]
    pressure = 1e4 * np.cos(2 * np.pi * per_mm * truth.across_mm) * resolution.fade(truth.across_mm, half_mm)
    u = truth.state(pressure).displacement[..., 2]
    middle = u[6] if axis == 0 else u[:, 7:9].mean(axis=1)
    at = resolution.Nodes.of(board).across(axis)
    near = np.abs(at) < 3
    wave_there = np.cos(2 * np.pi * per_mm * at[near])
    found = float(middle[near] @ wave_there / (wave_there @ wave_there))
    step_mm = float(truth.across_mm[1] - truth.across_mm[0])
    along = (np.array(k), np.array(0.0)) if axis == 0 else (np.array(0.0), np.array(k))
    exact = layer_compliance(*along, modulus_pa=2e5, poisson=0.48, thickness_m=4e-3)[2, 2].real
    assert found == pytest.approx(-1e4 * exact * np.sinc(per_mm * step_mm) ** 2, rel=0.05)


def test_the_verb_prints_the_rows_and_draws_the_curves(
    coarse: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(resolution, "DISTANCES_MM", np.array([0.8, 4.5]))
    monkeypatch.setattr(resolution, "FREQUENCIES", np.array([0.2, 0.5, 0.9]))
    words = [
        "bench",
        "ifem",
        "--board",
        str(coarse),
        "--only",
        "resolution",
        "--quick",
        "--out",
        str(tmp_path / "a.png"),
    ]
    done = CliRunner().invoke(app, [*words, "--json"], catch_exceptions=False)
    assert done.exit_code == 0
    result = json.loads(done.stdout)
    found = result["methods"]["default"]
    assert found["apart_mm"] == 4.5  # two lines closer than a node's step are one
    assert found["apart"][0] == 0
    for axis in ("x", "y"):
        low, middle, high = found["response"][axis]
        assert 1.1 > low > middle > high > -0.1
        assert low > 0.85
    exact = result["methods"]["exact"]["response"]["x"]
    np.testing.assert_allclose(exact, np.sinc(np.array([0.2, 0.5, 0.9]) / 2) ** 2, rtol=0.05)
    assert (tmp_path / "a.png").stat().st_size > 10_000
    text = resolution.table(result)
    assert all(part in text for part in ("lines told apart at", "4.5 mm", "default", "raw", "exact"))


def test_half_response_is_that_of_the_axis_that_falls_first() -> None:
    frequency = np.array([0.1, 0.2, 0.3])
    falls, stays, below = np.array([1.0, 0.8, 0.4]), np.array([1.0, 0.9, 0.8]), np.array([0.4, 0.3, 0.2])
    assert resolution.worse_axis(frequency, [stays, falls]) == ("y", pytest.approx(0.275))
    assert resolution.worse_axis(frequency, [falls, below]) == ("y", 0.0)
    assert resolution.worse_axis(frequency, [stays, stays]) == ("x", None)
    result = {"methods": {"raw": {"half_per_mm": 0.0, "apart_mm": 1.0}}, "distance_mm": [0.4, 4.0]}
    assert resolution.cells({**result, "frequency_per_mm": frequency}, "raw") == ("1.0 mm", "< 0.10 / mm")


def test_what_would_be_ignored_is_refused(tmp_path) -> None:
    only = ["bench", "ifem", "--board", "gelslim", "--only", "resolution"]
    done = CliRunner().invoke(app, [*only, "--truth", "finite"])
    assert done.exit_code != 0
    assert "linear pad" in str(done.exception) + done.output
    with pytest.raises(SystemExit):
        command.main(["--quick", "--table", str(tmp_path / "a.md")])


def test_a_refused_part_costs_no_other_part_of_the_bench(tmp_path: Path) -> None:
    folder = tmp_path / "gelslim"
    shutil.copytree(ROOT / "boards" / "gelslim", folder)
    text = (folder / "board.toml").read_text()
    (folder / "board.toml").write_text(text.replace("n_x = 31\nn_y = 25\n", "n_x = 8\nn_y = 7\n"))
    found = resolution.part(find_board(str(folder)), quick=True, progress=lambda _: None)
    assert resolution.table(found) == (
        "resolution: not measured: board 'gelslim' has nodes 2.9 mm apart: lines 0.3 mm wide need at most 2.6 mm"
    )


def test_boards_without_a_field_are_refused() -> None:
    with pytest.raises(InputError, match="measures no field of forces"):
        resolution.run(find_board("ftouch"), quick=True)
    done = CliRunner().invoke(app, ["bench", "ifem", "--board", "gelslim", "--only", "colours"])
    assert done.exit_code != 0


def test_the_document_gets_the_row_of_each_board() -> None:
    methods = {
        name: {"half_per_mm": half, "apart_mm": apart}
        for name, half, apart in (("default", 0.512, 1.7), ("raw", 0.561, None), ("exact", None, 1.5))
    }
    result = {
        "board": "toy", "is_measured": False, "node_limit_per_mm": 0.75, "methods": methods,
        "distance_mm": [0.4, 4.0], "frequency_per_mm": [0.1, 0.9],
    }  # fmt: skip
    row = command.row(result, "12345678", "2026-01-02")
    assert row == (
        "| toy, its depth calibrated | 0.67 mm | 1.7 mm | 0.51 / mm | > 4.0 mm, 0.56 / mm | 1.5 mm, > 0.90 / mm "
        "| 12345678 | 2026-01-02 |"
    )
    document = (ROOT / "docs" / "results" / "accuracy.md").read_text()
    assert row in gels.with_row(document, row, command.SECTION, command.COLUMNS)
