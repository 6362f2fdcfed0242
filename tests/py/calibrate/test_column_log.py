"""Force logs from elsewhere: read as they are, refused in one sentence where they cannot be right."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt
import pytest
from typer.testing import CliRunner

from ruffini.boards import find_board
from ruffini.calibrate import container
from ruffini.calibrate.log.columns import Columns, read_column_logs, read_plain_log
from ruffini.cli.app import app
from ruffini.errors import InputError
from ruffini.estimators.wrench.log import on_board
from ruffini.estimators.wrench.report import _rms
from ruffini.estimators.wrench.run import FeatureRun

Array = npt.NDArray[np.float64]
COLUMNS = Columns("t", ("moved",), "mm", ("wrench",), ("N", "N m"), "touch")
N_MARKERS, N_TOUCHES, N_FRAMES = 5, 12, 8
FULL = np.array([1.0, 1.0, 8.0, 0.02, 0.02, 0.02])  # N, N m


def made(seed: int, noise_mm: float = 0.002, n_markers: int = N_MARKERS) -> dict[str, Array]:
    """Touches of a linear sensor; displacements in mm, no untouched frames."""
    rng = np.random.default_rng(seed)
    peak = rng.uniform(-1, 1, (N_TOUCHES, 1, 6)) * FULL
    peak[..., 2] = -np.abs(peak[..., 2]) - 1
    wrench = (peak * np.linspace(0.3, 1, N_FRAMES)[:, None]).reshape(-1, 6)
    makes = np.random.default_rng(0).normal(size=(n_markers * 3, 6)) * 0.3 / FULL
    moved = wrench @ makes.T + rng.normal(size=(len(wrench), 3 * n_markers)) * noise_mm
    return {"t": 0.05 * np.arange(len(wrench)), "moved": moved.reshape(-1, n_markers, 3), "wrench": wrench,
            "touch": np.repeat(np.arange(1, N_TOUCHES + 1), N_FRAMES).astype(float)}  # fmt: skip


def hdf5(path: Path, log: dict[str, Array]) -> Path:
    with h5py.File(path, "w") as file:
        for name, values in log.items():
            file[name] = values
    return path


def as_csv(path: Path, log: dict[str, Array]) -> Path:
    moved = log["moved"].reshape(len(log["t"]), -1)
    names = ["t", "touch", *(f"m{i}" for i in range(moved.shape[1])), "fx", "fy", "fz", "tx", "ty", "tz"]
    table = np.column_stack([log["t"], log["touch"], moved, log["wrench"]])
    path.write_text("\n".join([",".join(names), *(",".join(map(repr, row)) for row in table.tolist())]))
    return path


def test_hdf5_and_csv_read_alike(tmp_path: Path) -> None:
    log = made(1)
    a = read_column_logs([hdf5(tmp_path / "a.h5", log)], COLUMNS)
    named = Columns("t", ("m*",), "mm", ("fx", "fy", "fz", "tx", "ty", "tz"), ("N", "N m"), "touch")
    b = read_column_logs([as_csv(tmp_path / "b.csv", log)], named)
    assert a.runs[0].features.tolist() == b.runs[0].features.tolist()
    assert a.runs[0].features[3, 4] == round(65536 * log["moved"][3, 1, 1])
    assert a.runs[0].reference == pytest.approx(b.runs[0].reference)
    assert b.names[9:11] == ["m9", "m10"]
    assert a.runs[0].touch is not None
    assert a.runs[0].touch[-1] == N_TOUCHES


def test_metres_torques_in_n_mm_and_features_without_a_unit(tmp_path: Path) -> None:
    log = made(1)
    log["moved"] *= 1e-3
    log["wrench"][:, 3:] *= 1e3
    columns = Columns("t", ("moved",), "m", ("wrench",), ("N", "N mm"), "touch")
    (run,) = read_column_logs([hdf5(tmp_path / "a.h5", log)], columns).runs
    assert run.features[3, 4] == round(65536e3 * log["moved"][3, 1, 1])
    assert run.reference[0, 3] == pytest.approx(1e-3 * log["wrench"][0, 3])
    read = read_column_logs([hdf5(tmp_path / "b.h5", log)], Columns("t", ("moved",), "", ("wrench",), ("N", "N mm")))
    assert (np.abs(read.runs[0].features).max(axis=0) >= 2**19).all()
    assert read.runs[0].features[3, 4] / read.step[4] == pytest.approx(log["moved"][3, 1, 1], rel=1e-3)


def changed(change: Callable[[dict[str, Array]], Any]) -> dict[str, Array]:
    log = made(2)
    change(log)
    return log


def _swapped(log: dict[str, Array]) -> None:
    log["wrench"] = log["wrench"][:, [2, 1, 0, 3, 4, 5]]


def _turned(log: dict[str, Array]) -> None:
    log["wrench"] = log["wrench"][:, [3, 4, 5, 0, 1, 2]]


BAD: dict[str, tuple[Callable[[dict[str, Array]], Any], str]] = {
    "nan": (lambda log: log["moved"].__setitem__((6, 2, 1), np.nan), r"b\.h5: moved\[2, 1\], row 7 is not a number: d"),
    "nan wrench": (lambda log: log["wrench"].__setitem__((3, 2), np.nan), r"wrench\[2\], row 4 is not a number"),
    "missing": (lambda log: log.pop("wrench"), r"b\.h5: has no column 'wrench', only moved, t, touch"),
    "N mm": (lambda log: log["wrench"].__setitem__(np.s_[:, 3:], log["wrench"][:, 3:] * 1e3 * 1e2),
             r"b\.h5: wrench\[\d\], row \d+: torques read as N m are .* --wrench-unit N,Nmm"),
    "swapped": (_swapped, r"b\.h5: wrench\[0\], row \d+: fx presses on average, fz hardly: .*--wrench in the order"),
    "torques for forces": (_turned, r"b\.h5: wrench\[\d\], row \d+: .* look swapped: name --wrench in the order"),
    "backwards": (lambda log: log["t"].__setitem__(9, 0.1), r"b\.h5: t, row 10: time runs backwards"),
    "metres": (lambda log: log.__setitem__("moved", log["moved"] * 1e-3), r"moved\[.*\], row \d+: .*Give --unit"),
    "nan touch": (lambda log: log["touch"].__setitem__(5, np.nan), r"b\.h5: touch, row 6 is not a number: delete"),
    "mN": (lambda log: log.__setitem__("wrench", log["wrench"] * 1e3), r"wrench\[2\], row \d+: .*they in mN\? Give"),
    "swapped in one": (lambda log: log.__setitem__("wrench", log["wrench"][:, [1, 0, 2, 3, 4, 5]]),
                       r"b\.h5: wrench\[0\], row \d+: fx and fy look swapped against a\.h5: name --wrench"),
    "torques swapped in one": (lambda log: log.__setitem__("wrench", log["wrench"][:, [0, 1, 2, 3, 5, 4]]),
                               r"b\.h5: wrench\[4\], row \d+: ty and tz look swapped against a\.h5"),
    "turned round in one": (lambda log: log.__setitem__("wrench", log["wrench"] * [1, -1, 1, 1, 1, 1]),
                            r"b\.h5: wrench\[1\], row \d+: fy has the other sign than in a\.h5: turn it"),
    "another unit in one": (lambda log: log.__setitem__("moved", log["moved"] * 20),
                            r"b\.h5: wrench\[0\], row \d+: fx is 0\.05\d* times what .* one unit"),
    "other rows": (lambda log: log.__setitem__("wrench", log["wrench"][1:]), r"b\.h5: t has 96 rows"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_a_bad_log_is_one_sentence_and_nothing_is_written(case: str, tmp_path: Path) -> None:
    change, sentence = BAD[case]
    log = changed(change)
    if case == "N mm":
        log["wrench"][:, :3] /= 1e2
    paths = [hdf5(tmp_path / "a.h5", made(1)), hdf5(tmp_path / "b.h5", log)]
    with pytest.raises(InputError, match=sentence) as caught:
        read_column_logs(paths, COLUMNS)
    assert caught.value.exit_code == 2
    assert "\n" not in str(caught.value)
    said = CliRunner().invoke(app, _command(paths, tmp_path / "out"))
    assert isinstance(said.exception, InputError)
    assert not (tmp_path / "out").exists()


def test_milliseconds_are_remarked(tmp_path: Path) -> None:
    log = made(1)
    log["t"] *= 1e3
    (said,) = read_column_logs([hdf5(tmp_path / "a.h5", log)], COLUMNS).remarks
    assert said == "a.h5: t: frames of a touch are 50 s apart: is it in ms?"


def test_a_recording_of_another_sensor(tmp_path: Path) -> None:
    paths = [hdf5(tmp_path / "a.h5", made(1)), hdf5(tmp_path / "b.h5", made(1, n_markers=6))]
    with pytest.raises(InputError, match=r"b\.h5: column moved\[5, 0\]: 18 features, a\.h5 has 15: .*another sensor"):
        read_column_logs(paths, COLUMNS)


def test_a_cell_that_is_no_number(tmp_path: Path) -> None:
    path = as_csv(tmp_path / "a.csv", made(1))
    rows = path.read_text().split("\n")
    rows[5] = rows[5].replace(rows[5].split(",")[4], "lost", 1)
    path.write_text("\n".join(rows))
    with pytest.raises(InputError, match=r"a\.csv: m2, row 5: 'lost' is no number"):
        read_column_logs([path], Columns("t", ("m*",), "mm", ("fx", "fy", "fz", "tx", "ty", "tz")))


def _command(paths: list[Path], out: Path) -> list[str]:
    return ["cal", "fit", "--only", "wrench", *map(str, paths), "--time", "t", "--features", "moved",
        "--unit", "mm", "--wrench",
            "wrench", "--touch", "touch", "--out", str(out), "--json"]  # fmt: skip


def test_two_recordings_without_untouched_frames_are_fitted(tmp_path: Path) -> None:
    """One left out at a time; what needs untouched frames is named; the same by a mapping file."""
    paths = [hdf5(tmp_path / f"{i}.h5", made(i)) for i in (1, 2)]
    out = tmp_path / "wrench.safetensors"
    result = CliRunner().invoke(app, _command(paths, out), catch_exceptions=False)
    said = json.loads(result.stdout)
    assert said["held_out_by"] == "recording"
    assert said["n_recordings"] == 2
    assert said["not_stated"]
    assert [Path(name).name for name in said["recordings"]] == ["1.h5", "2.h5"]
    for axis, full in zip(("Fx", "Fy", "Fz", "Tx", "Ty", "Tz"), FULL * [1, 1, 1, 1e3, 1e3, 1e3], strict=True):
        assert said["axes"][axis]["rmse"] < 0.02 * full
        assert 0 < said["axes"][axis]["mae"] < said["axes"][axis]["rmse"]
    assert "wrench" in container.read(out).kinds
    mapping = tmp_path / "columns.toml"
    mapping.write_text('time = "t"\nfeatures = ["moved"]\nunit = "mm"\nwrench = "wrench"\ntouch = "touch"\n')
    by_file = [
        "cal",
        "fit",
        "--only",
        "wrench",
        *map(str, paths),
        "--columns",
        str(mapping),
        "--out",
        str(out),
        "--json",
    ]
    again = json.loads(CliRunner().invoke(app, by_file, catch_exceptions=False).stdout)
    assert again["axes"] == said["axes"]


def test_one_frame_a_touch_and_one_recording(tmp_path: Path) -> None:
    log = made(3)
    log["touch"] = np.arange(len(log["t"])) + 1.0
    result = CliRunner().invoke(app, _command([hdf5(tmp_path / "a.h5", log)], tmp_path / "w"), catch_exceptions=False)
    said = json.loads(result.stdout)
    assert said["held_out_by"] == "block"
    assert said["lag_ms"] == 0


@pytest.mark.parametrize("times", [1e-3, 30.0])
def test_any_range(times: float, tmp_path: Path) -> None:
    """A thousandth and thirty times the force; a sensor's torques beyond 1,074 N mm are left out, and named."""
    paths = []
    for i in (1, 2):
        log = made(i)
        log["wrench"] *= times
        log["moved"] += 0.2 * np.abs(log["moved"]) * log["moved"]
        paths.append(hdf5(tmp_path / f"{i}.h5", log))
    result = CliRunner().invoke(app, _command(paths, tmp_path / "w"), catch_exceptions=False)
    said = json.loads(result.stdout)
    assert said["axes"]["Fz"]["rmse"] < 0.1 * said["axes"]["Fz"]["full_scale"]


def test_recordings_stay_apart_in_folders_and_under_long_numbers(tmp_path: Path) -> None:
    paths = []
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        paths.append(as_csv(tmp_path / folder / "log.csv", made(1)))
    columns = Columns("t", ("m*",), "mm", ("fx", "fy", "fz", "tx", "ty", "tz"), ("N", "N m"), "touch")
    assert len({run.recording for run in read_column_logs(paths, columns).runs}) == 2
    log = {**made(1), "day": np.repeat([20240101.0, 20240102.0], N_TOUCHES * N_FRAMES // 2)}
    read = read_column_logs([hdf5(tmp_path / "c.h5", log)], replace(COLUMNS, recording="day"))
    assert [run.name for run in read.runs] == ["c.h5/20240101", "c.h5/20240102"]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("time,feature_0,fz\n0,0.01,-1\n", "column feature_0, row 1: 0.01 is none of the board's integers"),
        ("time,feature_0,fz\n0,1,-1\n1,1e9,-1\n", "column feature_0, row 2: 1e\\+09 is none of the board's integers"),
    ],
)
def test_features_that_are_no_integers_of_a_board_are_refused(text: str, says: str, tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text(text)
    with pytest.raises(InputError, match=says):
        read_plain_log(tmp_path / "log.csv")


def test_recordings_are_numbered_and_a_file_is_itself_by_any_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = {**made(1), "session": np.repeat([1.2, 1.7], N_TOUCHES * N_FRAMES // 2)}
    path = hdf5(tmp_path / "log.h5", log)
    with pytest.raises(InputError, match=r"column session, row 1: 1\.2 is no whole number"):
        read_column_logs([path], replace(COLUMNS, recording="session"))
    monkeypatch.chdir(tmp_path)
    assert len({run.recording for run in read_column_logs([path, Path("log.h5")], COLUMNS).runs}) == 1


def test_tips_are_read_from_hdf5_too(tmp_path: Path) -> None:
    tips = np.repeat([b"ball", b"edge"], N_TOUCHES * N_FRAMES // 2)
    path = hdf5(tmp_path / "log.h5", {**made(1), "object": tips})
    assert [run.kind for run in read_column_logs([path], replace(COLUMNS, tip="object")).runs] == ["ball", "edge"]
    path = hdf5(tmp_path / "short.h5", {**made(1), "object": tips[1:]})
    with pytest.raises(InputError, match="object has 95 rows, t 96: one row a frame in each"):
        read_column_logs([path], replace(COLUMNS, tip="object"))


def test_a_misspelt_column_of_tips_is_one_sentence(tmp_path: Path) -> None:
    path = hdf5(tmp_path / "log.h5", made(1))
    with pytest.raises(InputError, match="has no column 'tipp'"):
        read_column_logs([path], replace(COLUMNS, tip="tipp"))


def test_a_boards_features_have_no_unit_of_length(tmp_path: Path) -> None:
    words = [*_command([hdf5(tmp_path / "a.h5", made(1))], tmp_path / "out"), "--board", "fibre-skin"]
    said = CliRunner().invoke(app, words)
    assert isinstance(said.exception, InputError)
    assert "--unit mm: board 'fibre-skin' makes integers of its spots" in str(said.exception)
    assert not (tmp_path / "out").exists()


def test_an_axis_along_which_the_reference_measured_nothing_is_not_judged() -> None:
    wrench = np.zeros((4, 6))
    wrench[:, 2] = [-1, -2, -3, -4]
    frames: Any = SimpleNamespace(wrench=wrench)
    assert _rms(wrench + 0.5, frames) == [None, None, 0.5, None, None, None]


def test_features_beyond_a_boards_integers_are_refused() -> None:
    run = FeatureRun(
        "a.csv", np.zeros(1), np.full((1, 100), 2.0**26 + 1), np.ones(1, bool), np.zeros(1), np.zeros((1, 6))
    )
    with pytest.raises(InputError, match=r"a\.csv: features beyond .* board 'fibre-skin'"):
        on_board(run, find_board("fibre-skin"))
