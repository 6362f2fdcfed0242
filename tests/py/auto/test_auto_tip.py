"""`ruffini cal auto` for a fingertip: its gates, what the line and the twin say of a frame, refusals, the whole way."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from ruffini.boards import find_board
from ruffini.calibrate.auto import fingertip as auto_tip
from ruffini.calibrate.auto.fingertip import TipAuto, eyes_apart_mm, row_of, than_before, truth_of
from ruffini.calibrate.container import CalibrationFile, base_metadata, pack, read
from ruffini.calibrate.fit.job import Job, Outcome, Progress
from ruffini.core import Pipeline
from ruffini.device.results import Contact
from ruffini.errors import InputError, RefusedError
from ruffini.estimators.fingertip.eyes import Eyes
from ruffini.estimators.fingertip.face import cells, rays
from ruffini.estimators.fingertip.field import kernel, places
from ruffini.estimators.fingertip.presses import axes
from ruffini.estimators.fingertip.report import figures_of
from ruffini.estimators.fingertip.stage import FINGERTIP
from ruffini.estimators.table import reported_by, task_of
from ruffini.estimators.task import Turned
from ruffini.sim.optics.renderer import Renderer
from ruffini.sim.reproduce.runs import runs_of
from ruffini.sim.reproduce.settings import load_reproduce
from ruffini.sim.settings import load_twin
from ruffini.wire import Schema

BOARD = find_board(Path(__file__).parents[3] / "boards" / "stereo-fingertip")
N_REST = BOARD.pipeline.n_rest_frames + 2
WAYS = (400, 900, 1400)  # um
TASK = task_of(BOARD)
assert isinstance(TASK, Turned)
VALID, INVALID, VIEW_LOST = 1, 3, 16384
REPORT: dict[str, Any] = {
    "n_presses": 30,
    "largest_n": 1.0,
    "mean_error_of_presses_left_out": {
        "both": {"force_n": 0.02, "way_mm": 0.03, "x_mm": 1.5, "y_mm": 1.5, "roll_deg": 1.0, "pitch_deg": 2.0}
    },
}


@pytest.mark.parametrize(
    ("name", "value", "gate"),
    [("force_n", 0.051, "force"), ("way_mm", 0.11, "way"), ("roll_deg", 5.1, "tilt"), ("n_presses", 9, "presses")],
)
def test_each_gate_fails_alone(name: str, value: float, gate: str) -> None:
    assert all(g.ok for g in FINGERTIP.gates(REPORT, BOARD))
    both = {**REPORT["mean_error_of_presses_left_out"]["both"], name: value}
    spoilt = {
        "largest_n": 1.0,
        "n_presses": value if name == "n_presses" else 30,
        "mean_error_of_presses_left_out": {"both": both},
    }
    assert [g.name for g in FINGERTIP.gates(spoilt, BOARD) if not g.ok] == [gate]


def test_what_is_in_force_is_not_replaced_by_what_is_worse() -> None:
    assert than_before(REPORT, {"error": 21.0}).ok is True
    assert than_before(REPORT, {"error": 19.0}).ok is False
    assert than_before(REPORT, {"error": float("nan")}).ok is None


def test_the_line_and_the_twin_say_the_same_in_the_same_units() -> None:
    axis = axes(0.3, -0.2)[:, 2]
    pose = np.array([[np.nan] * 6, [1.5e-3, -2e-3, 0.8e-3, 0.0, 0.3, -0.2]])
    wrench = np.vstack([np.zeros(6), [*(-0.7 * axis), 0, 0, 0]])
    true = truth_of(pose, wrench)
    assert np.isnan(true[0]).all()
    tool = {"normal_force_un": [round(v) for v in -0.7e6 * axis], "tool_um": [1500, -2000, 800],
            "turn_urad": [300_000, -200_000], "tool_sigma": [0] * 7}  # fmt: skip
    schema = Schema.own()
    said = row_of(Contact.from_message(schema.new("Contact", area_um2_k=78_540, tool=tool)))
    assert np.isnan(row_of(Contact.from_message(schema.new("Contact", area_um2_k=78_540)))).all()
    np.testing.assert_allclose(said[:6], true[1, :6], atol=1e-5)
    assert said[6] == pytest.approx(78.54)
    none = np.full(7, np.nan)
    figures = figures_of(np.stack([said + 0.1, none]), np.stack([true[1], true[1]]), 1)
    assert (figures["frames"], figures["told"]) == (2, 1)
    assert figures["error"] == pytest.approx(100, abs=0.1)
    assert figures["mean"]["x_mm"] == pytest.approx(0.1)


def test_progress_is_told_at_tenths_with_the_time_that_is_left() -> None:
    said: list[str] = []
    tell = auto_tip.tenths("presses", said.append, iter([10.0, 14.0, 30.0]).__next__)
    for done in (0.525, 0.55, 0.575, 0.625, 0.65, 1.0):
        tell(done)
    assert said == ["presses: 52 %", "presses: 62 %; 15 s to go", "presses: 100 %; 0 s to go"]


def test_the_twins_eyes_are_10_mm_apart() -> None:
    assert eyes_apart_mm(BOARD) == 10
    with pytest.raises(InputError, match="two eyes"):
        eyes_apart_mm(find_board("gelslim"))


@pytest.fixture(scope="module")
def dome() -> Renderer:
    return Renderer.over_chart(BOARD, load_twin(BOARD))


def record(dome: Renderer, folder: Path) -> None:
    """A dent that grows, as the twin would have recorded it."""
    (folder / "frames").mkdir(parents=True)
    a, b = np.meshgrid(dome.node_a_mm, dome.node_b_mm)
    pose, wrench = np.full((N_REST + len(WAYS), 6), np.nan), np.zeros((N_REST + len(WAYS), 6))
    for i in range(len(pose)):
        way = WAYS[i - N_REST] * 1e-6 if i >= N_REST else 0.0
        down = -way * np.exp(-((a - 2) ** 2 + (b + 1) ** 2) / 40)
        moved = np.stack([0 * down, 0 * down, down], axis=-1).reshape(-1, 3)
        cv2.imwrite(str(folder / "frames" / f"{i:04d}.png"), dome.image(moved, np.random.default_rng(i)))
        if way:
            pose[i], wrench[i, 2] = [0, 0, way, 0, 0, 0], -500 * way
    np.savez(folder / "truth.npz", pose=pose, wrench=wrench)
    (folder / "run.json").write_text("{}")


def tables(recording: Path) -> CalibrationFile:
    """Tables of a network that says something, on this dome's pins."""
    with Pipeline(BOARD) as path:
        for i in range(N_REST):
            path.process(cv2.imread(str(recording / "frames" / f"{i:04d}.png")))
        rest = path.markers()[0]
    eyes, rng = Eyes.of(BOARD, 10.0), np.random.default_rng(1)
    pair = eyes.pairs(*rest)
    pins = np.stack([rest[eye][pair[:, eye]] for eye in range(2)])
    place, at = eyes.place(pins), places(eyes.radius_mm)
    n = 3 * len(at) + 2
    out: dict[str, npt.ArrayLike] = {
        "rest": pins * 256, "normal": eyes.normals(place) * 2**14, "gain": eyes.gains(place) * 256e3,
        "place": at * 2**14, "kernel": kernel(eyes.radius_mm) * 2**15, "gate": [768, 1600], "mean": np.zeros((3, n)),
        "near": np.zeros((3, 4)),
        "length": np.ones((3, 4)), "limit": np.full((3, 2), 30_000), "trust": np.full((3, 7), 256),
        "zero": [500_000, 1000, 0, 0, 0, 0, 9000], "scale": [250_000, 600, 3000, 3000, 140_000, 140_000, 1500],
        "weight0": rng.normal(0, 3000, (3, 4, n)), "ray": rays(22.0) * 2**14, "cell": cells() * 1e6, "tip": [328_000],
        "face_axis": [[0, 500_000, 3], [0, 1000, 3], [768, 1500, 3], [512, 1800, 3]],
        "face": np.tile([80_000, 6000, 60_000], (81, 1)),
    }  # fmt: skip
    for i, (n_in, n_out) in enumerate(((4, 8), (8, 8), (8, 14)), 1):
        out[f"weight{i}"], out[f"bias{i}"] = rng.normal(0, 2**14, (3, n_out, n_in)), np.zeros((3, n_out))
    tensors = {f"fingertip.{k}": np.round(np.asarray(v)).astype(np.int32) for k, v in out.items()}
    return pack(tensors, {**base_metadata(BOARD), "kinds": "fingertip", "fingertip.most_un": "1300000"})


def test_made_fitted_flashed_and_judged_over_the_line(
    dome: Renderer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = next(r for r in runs_of(load_reproduce(BOARD, "presses.toml"), quick=True) if r.settings.part == "judge")
    recording = tmp_path / "presses" / run.key
    record(dome, recording)
    file = tables(recording)
    monkeypatch.setattr(auto_tip, "reproduce", lambda *_, **__: None)
    report = REPORT

    def fit(job: Job, _: Progress) -> Outcome:
        job.tensors |= file.tensors
        job.metadata["fingertip.most_un"] = file.metadata["fingertip.most_un"]
        return Outcome("fitted", "", report)

    monkeypatch.setattr(FINGERTIP, "fit", fit)
    result = TipAuto(BOARD, TASK, tmp_path, 10.0, lambda _: None, is_quick=True).run()
    made = read(tmp_path / "calibration.safetensors")
    assert json.loads((tmp_path / "result.json").read_text())["sha256"] == made.sha256.hex()
    assert made.tensors.keys() == file.tensors.keys()
    assert made.metadata["gates"] == "passed"
    for page in ("auto.html", "report.html"):
        assert "SIMULATED" in (tmp_path / page).read_text()
    assert result["after"]["frames"] == result["after"]["told"] == len(WAYS)
    forces, flat = [], []
    with Pipeline(BOARD, file.data) as core:
        for i in range(N_REST + len(WAYS)):
            core.process(cv2.imread(str(recording / "frames" / f"{i:04d}.png")))
            if i >= N_REST:
                forces.append(1e-6 * core.tip().force_un)
                flat.append(core.tip().flat_um2)
    off = 1e3 * np.abs(np.array(forces) - [500e-6 * way for way in WAYS]).mean()
    assert result["after"]["error"] == pytest.approx(off, abs=1e-2)
    assert min(flat) > 20e6  # a wall that is dented lies in some plane to 0.3 mm over more than 41 mm^2
    report = {**REPORT, "n_presses": 3}
    with pytest.raises(RefusedError, match=r"not flashed.*presses: 3 presses, at least 10"):
        TipAuto(BOARD, TASK, tmp_path, 10.0, lambda _: None, is_quick=True).run()


def test_a_report_judges_presses_that_were_not_fitted_on_the_boards_integers(dome: Renderer, tmp_path: Path) -> None:
    press = tmp_path / "presses" / "a"
    record(dome, press)
    told = [",,,,,,"] * N_REST + [f"{500e-6 * way},{1e-3 * way},0,0,0,0," for way in WAYS]
    (press / "press.csv").write_text("\n".join(["force_n,way_mm,x_mm,y_mm,roll_deg,pitch_deg,area_mm2", *told, ""]))
    file, off_n = tables(press), []
    with Pipeline(BOARD, file.data) as core:
        for i in range(N_REST + len(WAYS)):
            core.process(cv2.imread(str(press / "frames" / f"{i:04d}.png")))
            if i >= N_REST:
                off_n.append(abs(1e-6 * core.tip().force_un - 500e-6 * WAYS[i - N_REST]))
    made = FINGERTIP.report(BOARD, file, [tmp_path / "presses"], previous=file)
    assert made.tree["log"] | {"files": None} == {
        "files": None, "touches": 1, "frames": len(WAYS), "in_the_fit": False, "simulated": True,
    }  # fmt: skip
    assert made.tree["fingertip"] == made.tree["previous"]
    assert made.tree["fingertip"]["mean"]["force_n"] == pytest.approx(np.mean(off_n))
    assert not made.tree["passed"]
    assert "presses" in [gate.name for gate in made.gates if not gate.ok]
    made.write_page(tmp_path / "report.html")
    assert "3 frames of 1 presses" in (tmp_path / "report.html").read_text()
    assert reported_by(file) is FINGERTIP
    assert made.tree["fingertip"]["against"] == "the twin's truth"
    (press / "run.json").unlink()  # as a bench's
    made = FINGERTIP.report(BOARD, file, [tmp_path / "presses"])
    assert (made.tree["log"]["simulated"], made.tree["fingertip"]["against"]) == (False, "the reference")


@pytest.mark.parametrize(("eyes", "is_seen"), [((0,), True), ((1,), False), ((0, 1), False)])
def test_a_thing_before_some_pins_is_flagged_and_the_other_eye_goes_on(
    dome: Renderer, tmp_path: Path, eyes: tuple[int, ...], *, is_seen: bool
) -> None:
    """The left eye alone looks at this dent along its way: what it cannot feel is invalid, not zero."""
    record(dome, tmp_path / "press")
    file, width = tables(tmp_path / "press"), BOARD.camera.width_px // 2
    for covered in ((), eyes):
        with Pipeline(BOARD, file.data) as core:
            for i in range(N_REST + len(WAYS)):
                picture = cv2.imread(str(tmp_path / "press" / "frames" / f"{i:04d}.png"))
                for eye in covered if i >= N_REST else ():
                    cv2.circle(picture, (width // 2 + width * eye, 120), 20, (0, 0, 0), -1)
                said = core.process(picture)
            core_says = bool(core.tip().is_touched)
    assert said.flags & VIEW_LOST
    assert core_says == is_seen
    if not said.saturations:  # tables that no fit gives
        assert said.force_z_validity == (VALID if is_seen else INVALID)


def test_pins_that_are_smeared_in_both_eyes_are_invalid(dome: Renderer, tmp_path: Path) -> None:
    record(dome, tmp_path / "press")
    with Pipeline(BOARD, tables(tmp_path / "press").data) as core:
        for i in range(N_REST + len(WAYS)):
            picture = cv2.imread(str(tmp_path / "press" / "frames" / f"{i:04d}.png"))
            said = core.process(cv2.GaussianBlur(picture, (15, 15), 0) if i >= N_REST else picture)
    assert said.flags & VIEW_LOST
    assert said.force_z_validity == INVALID
