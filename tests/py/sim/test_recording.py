"""Recordings: whole, repeatable, with the truth that belongs to them."""

import csv
import dataclasses
import errno
import os
from pathlib import Path

import cv2
import numpy as np
import pytest
import tomllib

from ruffini.boards import find_board
from ruffini.errors import InputError
from ruffini.sim import cache, programs
from ruffini.sim.contact import Indenter, Pose
from ruffini.sim.optics.settings import SensorSettings
from ruffini.sim.pad import PadModel
from ruffini.sim.programs import Rest, Touch
from ruffini.sim.recording import record_balls, record_touches
from ruffini.sim.scenario import scenario_of
from ruffini.sim.serve import Scripted, TwinServer
from ruffini.sim.settings import MeshSettings
from ruffini.sim.unit import PadError, pad_model

MM = 1e-3
STORY = [
    Rest(2),
    Touch(Indenter("sphere", 3 * MM), [Pose(MM, 0, 0.3 * MM), Pose(1.1 * MM, 0, 0.5 * MM)], [False, True]),
    Rest(1),
]


def recorded(unit, out, seed=1):
    record_touches(unit, STORY, out, seed=seed, program="test")
    return np.load(out / "truth.npz")


def test_recording_holds_frames_truth_and_settings(coarse_unit, tmp_path):
    truth = recorded(coarse_unit, tmp_path / "out")
    frames = sorted((tmp_path / "out" / "frames").iterdir())
    assert [f.name for f in frames] == [f"{i:06d}.png" for i in range(5)]
    assert cv2.imread(str(frames[0])).shape == (240, 320, 3)
    assert truth["judged"].tolist() == [False, False, False, True, False]
    assert truth["touch"].tolist() == [-1, -1, 0, 0, -1]
    assert truth["wrench"].shape == (5, 6)
    assert truth["force"].shape == truth["displacement"].shape == (5, 25, 31, 3)
    assert not truth["wrench"][[0, 1, 4]].any()
    np.testing.assert_allclose(truth["pose"][3], [1.1 * MM, 0, 0.5 * MM, 0, 0, 0])
    assert truth["time_s"][1] == pytest.approx(1 / 60)
    settings = tomllib.loads((tmp_path / "out" / "recording.toml").read_text())
    assert settings["simulated"] is True
    assert (settings["board"], settings["seed"]) == ("gelslim", 1)
    assert settings["pad"]["poisson"] == pytest.approx(0.48)
    assert settings["twin"]["light"]["mean_level"] == 105


def test_nodal_truth_sums_to_the_wrench(coarse_unit, tmp_path):
    truth = recorded(coarse_unit, tmp_path / "out")
    x, y = np.linspace(-10 * MM, 10 * MM, 31), np.linspace(-8 * MM, 8 * MM, 25)
    arm = np.stack([*np.meshgrid(x, y), np.zeros((25, 31))], axis=-1)
    force = truth["force"]
    sums = np.concatenate([force.sum((1, 2)), np.cross(arm, force).sum((1, 2))], axis=1)
    np.testing.assert_allclose(sums, truth["wrench"], atol=1e-12)
    assert truth["wrench"][3, 2] < -0.2
    assert truth["wrench"][3, 0] > 0.01


def test_displacement_truth_is_the_indenter_under_it(coarse_unit, tmp_path):
    """The deepest node lies on the ball with its lowest point at (1.1, 0) mm; the mesh here is coarse."""
    u = recorded(coarse_unit, tmp_path / "out")["displacement"][3]
    row, column = np.unravel_index(u[:, :, 2].argmin(), (25, 31))
    x, y = np.linspace(-10, 10, 31)[column], np.linspace(-8, 8, 25)[row]
    ball = 3 - np.sqrt(9 - (x + u[row, column, 0] * 1e3 - 1.1) ** 2 - (y + u[row, column, 1] * 1e3) ** 2)
    assert u[row, column, 2] * 1e3 == pytest.approx(ball - 0.5, abs=0.08)


def test_same_seed_same_bytes(coarse_unit, tmp_path):
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        recorded(coarse_unit, tmp_path / name, seed)
    names = sorted(p.relative_to(tmp_path / "a") for p in (tmp_path / "a").rglob("*") if p.is_file())
    assert len(names) == 7
    for name in names:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes(), name
    frame = Path("frames/000000.png")
    assert (tmp_path / "a" / frame).read_bytes() != (tmp_path / "c" / frame).read_bytes()


def test_folder_in_use_is_refused(coarse_unit, tmp_path):
    (tmp_path / "mine").write_text("keep")
    with pytest.raises(InputError, match="choose another --out"):
        recorded(coarse_unit, tmp_path)
    with pytest.raises(InputError, match="choose another --out"):
        record_balls(coarse_unit, 1, tmp_path / "mine", ball_mm=5.0, seed=1)
    assert (tmp_path / "mine").read_text() == "keep"


def test_full_disk_leaves_valid_frames(coarse_unit, tmp_path, monkeypatch):
    write_bytes, written = Path.write_bytes, []

    def small_disk(path, data):
        if len(written) == 3:
            write_bytes(path, data[: len(data) // 2])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        written.append(path)
        return write_bytes(path, data)

    monkeypatch.setattr(Path, "write_bytes", small_disk)
    with pytest.raises(InputError, match=r"000003\.png cannot be written \(No space left"):
        recorded(coarse_unit, tmp_path / "out")
    left = sorted((tmp_path / "out").rglob("*.p*"))
    assert [p.name for p in left] == ["000000.png", "000001.png", "000002.png"]
    assert all(cv2.imread(str(p)) is not None for p in left)


def test_ball_presses_are_marked_where_they_are(coarse_unit, tmp_path):
    record_balls(coarse_unit, 4, tmp_path / "balls", ball_mm=5.0, seed=3)
    rows = list(csv.DictReader((tmp_path / "balls" / "presses.csv").open()))
    scale = tomllib.loads((tmp_path / "balls" / "presses.toml").read_text())
    assert scale == {"ball_mm": 5.0, "px_per_mm": 15.0}
    assert len(rows) == 4
    reference = np.mean([cv2.imread(str(p)) for p in (tmp_path / "balls").glob("reference_*.png")], axis=0, dtype=float)
    v, u = np.mgrid[:240, :320]
    for row in rows:
        change = np.abs(cv2.imread(str(tmp_path / "balls" / row["image"])) - reference).sum(axis=2)
        change = np.maximum(cv2.GaussianBlur(change, (0, 0), 6) - 12, 0)
        center = (change * u).sum() / change.sum(), (change * v).sum() / change.sum()
        at = float(row["center_x_px"]), float(row["center_y_px"])
        radius = float(row["contact_radius_px"])
        assert np.hypot(center[0] - at[0], center[1] - at[1]) < radius / 2
        assert 8 < radius < 2.5 * 15


def test_programs_stay_on_the_pad_and_say_what_is_judged():
    board = find_board("gelslim")
    touches = [s for s in programs.grid(board, 60, np.random.default_rng(1)) if isinstance(s, Touch)]
    assert len(touches) == 60
    for touch in touches:
        held = touch.poses[touch.judged.index(True)]
        assert sum(touch.judged) == 1
        assert 0.3 * MM <= held.depth_m <= 1.2 * MM
        assert abs(held.x_m) + touch.indenter.radius_m < 12 * MM
        assert touch.poses[-1].depth_m == 0
    sheared = sum(t.poses[0].x_m != t.poses[t.judged.index(True)].x_m for t in touches)
    assert 15 < sheared < 45
    assert {t.indenter.shape for t in touches} == {"sphere", "flat"}
    demo = programs.demo(board)
    assert isinstance(demo[0], Rest)
    assert demo[0].n_frames >= 10
    assert 140 <= programs.n_frames_of(demo) <= 170


def test_cache_is_only_faster(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    model = PadModel(6 * MM, 4 * MM, 3 * MM, 2e5, 0.4, 3, 2, layers=(0.4, 0.6))
    computed = cache.cached_compliance(model)
    (file,) = cache.cache_folder().iterdir()
    np.testing.assert_array_equal(cache.cached_compliance(model), computed)
    file.write_bytes(file.read_bytes()[:1000])  # torn
    np.testing.assert_array_equal(cache.cached_compliance(model), computed)
    for at in (200, file.stat().st_size // 2, file.stat().st_size - 40):  # a number that is another one looks as good
        data = bytearray(file.read_bytes())
        data[at] ^= 0x10
        file.write_bytes(data)
        np.testing.assert_array_equal(cache.cached_compliance(model), computed)
    n_bytes = file.stat().st_size
    monkeypatch.setattr(cache, "KEPT_BYTES", 3 * n_bytes)
    for thickness in range(5):
        cache.cached_compliance(PadModel(6 * MM, 4 * MM, (4 + thickness) * MM, 2e5, 0.4, 3, 2, (0.4, 0.6)))
    assert len(list(cache.cache_folder().iterdir())) == 3
    cache.cached_compliance(PadModel(6 * MM, 4 * MM, 3 * MM, 2e5, 0.4, 2, 2, (0.4, 0.6)))
    assert len(list(cache.cache_folder().iterdir())) == 3  # with one that is smaller
    monkeypatch.setattr(cache, "KEPT_BYTES", n_bytes // 2)
    cache.cached_compliance(model)
    assert list(cache.cache_folder().iterdir()) == [file]  # the newest stays, however large
    blocked = tmp_path / "file"
    blocked.write_text("no folder")
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    np.testing.assert_array_equal(cache.cached_compliance(model), computed)


def test_a_spoilt_state_is_made_again(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    n_made = 0

    def make():
        nonlocal n_made
        n_made += 1
        return {"u": np.arange(300.0), "n": np.array(3)}

    for spoil in (None, 0, 100, 900, -1):
        file = next(cache.cache_folder().glob("states/*.npz"), None)
        if spoil is not None and file is not None:
            data = bytearray(file.read_bytes())
            data[spoil] ^= 1
            file.write_bytes(data)
        for _ in range(2):
            state = cache.cached_state("key", make)
            np.testing.assert_array_equal(state["u"], np.arange(300.0))
    assert n_made == 5


def test_impossible_pads_are_refused():
    with pytest.raises(InputError, match="cannot be simulated"):
        pad_model(find_board("gelslim"), PadError(poisson=1.05), MeshSettings())
    with pytest.raises(InputError, match="cannot be simulated"):
        pad_model(find_board("gelslim"), PadError(thickness=0.0), MeshSettings())


def test_faults_are_in_the_recording_and_its_settings(coarse_unit, tmp_path):
    faults = scenario_of(
        {"fault": [
            {"kind": "stall", "first_frame": 1, "n_frames": 1},
            {"kind": "lens_cap", "first_frame": 3, "n_frames": 1},
        ]},
        "test",
    ).fault  # fmt: skip
    count = record_touches(coarse_unit, STORY, tmp_path / "out", seed=1, program="test", faults=faults)
    truth = np.load(tmp_path / "out" / "truth.npz")
    assert count == 4
    assert truth["frame"].tolist() == [0, 2, 3, 4]
    assert truth["judged"].tolist() == [False, False, True, False]
    np.testing.assert_allclose(truth["time_s"], np.array([0, 2, 3, 4]) / 60)
    levels = [cv2.imread(str(p)).mean() for p in sorted((tmp_path / "out" / "frames").iterdir())]
    assert levels[2] < 5 < 90 < min(levels[0], levels[1], levels[3])
    settings = tomllib.loads((tmp_path / "out" / "recording.toml").read_text())
    assert [f["kind"] for f in settings["fault"]] == ["stall", "lens_cap"]


def test_live_twin_and_recording_show_the_same_pictures(coarse_unit, tmp_path):
    """With motion blur, which hangs on the frame before."""
    twin = coarse_unit.twin.model_copy(update={"sensor": SensorSettings(shutter_1e3=500)})
    unit = dataclasses.replace(coarse_unit, twin=twin)
    scenario = scenario_of({"program": "grid", "n": 1, "seed": 3}, "test")
    record_touches(unit, scenario.story(unit.board), tmp_path / "out", seed=3, program="grid")
    frames = sorted((tmp_path / "out" / "frames").iterdir())
    live = TwinServer(unit.renderer(), Scripted(unit, scenario), scenario, tmp_path / "socket")
    for i in (12, 15, 3):
        assert (live.picture(i) == cv2.imread(str(frames[i]))).all()
    assert live.picture(len(frames)) is None
