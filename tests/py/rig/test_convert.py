"""A CSV from elsewhere as a log: the example of the README, and files that are wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ruffini.boards import find_board
from ruffini.errors import InputError
from ruffini.rig.convert import at_nodes, convert
from ruffini.rig.log_file import read_log, write_log

POUND_N = 4.4482216152605
N_TOUCHES = 12
STIFFNESS = np.array([[900.0, 20, 0], [-15, 850, 30], [10, 5, 2600]])  # N m^-1 or N a unit of area
EXAMPLES = Path(__file__).parents[3] / "host" / "examples"
THEIRS = (EXAMPLES / "tray.toml").read_text()


def example(*, n_touches: int = N_TOUCHES, n_rows: int = 200, seed: int = 1) -> str:
    """Three targets on a sprung tray and a reference in pounds, as another program would write them, 2 s a touch."""
    rng = np.random.default_rng(seed)
    rows = ["Time,Fx,Fy,Fz," + ",".join(f"u{i},v{i},A{i}" for i in (1, 2, 3)) + ",remark"]
    for n in range(n_touches):
        peak = np.array([*rng.uniform(-2e-4, 2e-4, 2), -rng.uniform(2e-4, 6e-4)])
        for k in range(n_rows):
            ramp = np.clip(min(k / n_rows - 0.25, 0.75 - k / n_rows) / 0.15, 0, 1)
            moved = ramp * peak
            force = (STIFFNESS @ moved + [0.1, 0.0, -0.5]) / POUND_N  # what hangs on the reference is not tared
            force += 1e-4 * rng.normal(size=3)
            markers = [f"{1e3 * moved[0]:.6f},{1e3 * moved[1]:.6f},{moved[2]:.7f}"] * 3
            time_ms = 2000 * (n * n_rows + k) // n_rows
            rows.append(f"{time_ms},{force[0]:.6f},{force[1]:.6f},{force[2]:.6f},{','.join(markers)},ok")
    return "\n".join(rows) + "\n"


def test_the_example_of_the_readme_is_this():
    assert (EXAMPLES / "tray.csv").read_text() == example(n_touches=4, n_rows=100)


@pytest.fixture
def files(tmp_path):
    csv, columns = tmp_path / "theirs.csv", tmp_path / "columns.toml"
    csv.write_text(example())
    columns.write_text(THEIRS)
    return csv, columns


def test_the_worked_example_is_converted_and_fitted(files, tmp_path):
    write_log(tmp_path / "log.h5", convert(*files))
    log = read_log(tmp_path / "log.h5")
    assert len(log.touches) == N_TOUCHES
    assert log.facts["marker_unit"] == "m"
    features, forces = [], []
    for touch in log.touches:  # as the README does it
        features.append(touch.arrays["marker_displacement"].reshape(len(touch.arrays["marker_s"]), -1))
        forces.append(touch.arrays["reference_wrench"][:, :3])
    # All three targets move alike here: one of them says it all.
    fitted, *_ = np.linalg.lstsq(np.vstack(features)[:, :3], np.vstack(forces), rcond=None)
    assert np.allclose(fitted.T, STIFFNESS, atol=15)
    touch = log.touches[0]
    assert touch.facts["kind"] == "converted"
    held = (touch.arrays["reference_s"] > touch.facts["held_host_s"]) & (
        touch.arrays["reference_s"] < touch.facts["lifted_host_s"]
    )
    assert 40 < held.sum() < 110
    assert np.isnan(touch.arrays["stream_wrench"]).all()


def test_touches_that_the_file_counts_itself_and_a_tip(tmp_path):
    rows = [f"{k * 0.01},{-1.0 * (k % 50 > 20)},{k // 50 + 1 if k % 50 > 20 else 0},1.0,2.0,{-0.1 * (k % 5)},0.01,0.02"
            for k in range(100)]  # fmt: skip
    (tmp_path / "c.csv").write_text("\n".join(["time_s,fz_N,touch,x_mm,y_mm,z_mm,m0_dx_px,m0_dy_px", *rows]))
    log = convert(tmp_path / "c.csv")
    assert [len(t.arrays["reference_s"]) for t in log.touches] == [29, 29]
    assert log.touches[0].arrays["stage_place"][0] == pytest.approx([1e-3, 2e-3, -1e-4])
    assert log.facts["marker_unit"] == "px"
    assert log.touches[0].arrays["marker_displacement"][0, 0] == pytest.approx([0.01, 0.02])


def test_displacement_of_three_axes_is_given_at_the_nodes_of_the_board(tmp_path):
    board = find_board("gelslim")
    places = [(x, y) for y in np.linspace(-6, 6, 5) for x in np.linspace(-8, 8, 6)]
    head = [f"m{i}_{q}_mm" for i in range(len(places)) for q in ("x", "y", "dx", "dy", "dz")]
    rows = []
    for k in range(40):
        s = 1.0 * (15 <= k < 35)
        values = [v for x, y in places for v in (x, y, s * 0.01 * x, s * 0.02 * y, s * (-0.1 + 0.005 * x))]
        rows.append(",".join([f"{0.1 * k:.2f}", f"{-s}", *(f"{v:.6f}" for v in values)]))
    (tmp_path / "d.csv").write_text("\n".join([",".join(["time_s", "fz_N", *head]), *rows]))
    write_log(tmp_path / "d.h5", convert(tmp_path / "d.csv", None, board))
    field = read_log(tmp_path / "d.h5").touches[0].arrays["field_displacement"]
    assert field.shape == (20, 25, 31, 3)
    x = np.linspace(-10e-3, 10e-3, 31)
    assert field[0, 12, :, 0] == pytest.approx(0.01 * x, abs=2e-6)
    assert field[0, 12, :, 2] == pytest.approx(-1e-4 + 0.005 * x, abs=2e-6)
    assert at_nodes(board, np.array(places) * 1e-3, np.zeros((1, 30, 3))).max() == 0


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("time_ms", "tim_ms", "no column of time"),
        ('time_ms = "Time"', "", "no column of time"),
        ("fz_lbf", "fz_stone", "no unit of force"),
        ('"v{i}"', '"w{i}"', "has no column 'w1'"),
        ('"m{i}_dy_mm"', '"m{i}_dy_px"', "need one unit"),
        ('"m{i}_dy_mm" = "v{i}"', "", "marker 0 has no column m0_dy"),
        ("[columns]", "[colums]", "colums: unknown"),
        ("first = 1", "first = ", "cannot be read"),
    ],
)
def test_what_is_wrong_is_named(files, old, new, sentence):
    csv, columns = files
    columns.write_text(THEIRS.replace(old, new))
    with pytest.raises(InputError, match=sentence):
        convert(csv, columns)


GAUGES = """
[gauges]
columns = ["g0", "g1", "g2", "g3", "g4", "g5"]
matrix = [[0, 4, 0, 0, 0, 0], [0, 0, 1, 0, 0, 0], [2, 0, 0, 0, 0, 0],
          [0, 0, 0, 1, 0, 0], [0, 0, 0, 0, 1, 0], [0, 0, 0, 0, 0, 1]]
"""


def test_voltages_are_converted_as_a_benchs_file_says(tmp_path):
    csv, columns = tmp_path / "daq.csv", tmp_path / "columns.toml"
    rows = [f"{0.01 * k:.2f},{-0.5 * (20 < k < 80)},{0.25 * (20 < k < 80)},0,0,0,0" for k in range(100)]
    csv.write_text("\n".join(["Clock,g0,g1,g2,g3,g4,g5", *rows]))
    columns.write_text('[columns]\ntime_s = "Clock"\n' + GAUGES)
    (touch,) = convert(csv, columns).touches
    is_held = (touch.arrays["reference_s"] > 0.3) & (touch.arrays["reference_s"] < 0.7)
    assert touch.arrays["reference_wrench"][is_held][0].tolist() == [1, 0, -1, 0, 0, 0]


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("[gauges]", "gauges = 3\n[other]", "other: unknown"),
        ("[gauges]", "[gauges]\nunit = 3", r"columns\.toml: gauges: give \[gauges\] with columns and matrix, and"),
        ("[2, 0, 0", "[0, 4, 0", r"columns\.toml: gauges: matrix is singular"),
        ("[2, 0, 0", "[2, 0", r"columns\.toml: gauges: matrix must be six rows"),
        ('"g5"', '"u1"', "has no column 'u1', only"),
    ],
)
def test_gauges_that_are_wrong_are_named(tmp_path, old, new, sentence):
    csv, columns = tmp_path / "daq.csv", tmp_path / "columns.toml"
    columns.write_text('[columns]\ntime_s = "Time"\n' + GAUGES.replace(old, new))
    csv.write_text("Time,g0,g1,g2,g3,g4,g5\n0,0,0,0,0,0,0\n1,0,0,0,0,0,0\n")
    with pytest.raises(InputError, match=sentence):
        convert(csv, columns)


def test_a_file_that_begins_in_a_touch_or_has_none(files):
    csv, columns = files
    head, *rows = csv.read_text().splitlines()
    csv.write_text("\n".join([head, *rows[60:400]]))
    with pytest.raises(InputError, match="nothing may touch in the first 10 rows"):
        convert(csv, columns)
    csv.write_text("\n".join([head, *rows[:40]]))
    with pytest.raises(InputError, match=r"no touch of 0\.09 N"):
        convert(csv, columns)
