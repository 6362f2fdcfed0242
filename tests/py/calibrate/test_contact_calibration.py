"""What `cal fit --only contact` fits: made-up flows whose wrench, depth and hardness are known."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from ruffini.boards import Board, find_board
from ruffini.calibrate.container import CalibrationFile, base_metadata, pack
from ruffini.errors import InputError
from ruffini.estimators.contact_model.fit import Log as Fitted
from ruffini.estimators.contact_model.fit import fit_model, inputs_of, tell, true_sizes
from ruffini.estimators.contact_model.log import Press, read_presses
from ruffini.estimators.contact_model.perceptron import Perceptron, run_tables, tanh_table
from ruffini.estimators.contact_model.profile import radial_um
from ruffini.estimators.contact_model.stage import CONTACT
from ruffini.estimators.contact_model.tables import fit_contact, tables
from ruffini.estimators.contact_model.wrench import fit_contact_wrench, moment_per_flow, symmetric
from ruffini.estimators.table import reported_by
from ruffini.estimators.wrench.log import features_of
from ruffini.rig.log_file import Log, TouchRecord, write_log

Array = npt.NDArray[np.float64]
CROSSTALK = np.array([0.02, 0.03, 0.0, 1e-3, -2e-3, 1.5e-3])  # of the bench: N/N and N m/N
PX_PER_MM = 8.0


@pytest.fixture(scope="module")
def board() -> Board:
    return find_board("contact-glitter")


def lattice(board: Board) -> Array:
    m = board.markers
    assert m is not None
    x = (np.arange(m.n_x) - (m.n_x - 1) / 2) * m.pitch_x_um * 1e-3
    y = (np.arange(m.n_y) - (m.n_y - 1) / 2) * m.pitch_y_um * 1e-3
    return np.stack(np.meshgrid(x, y), axis=-1)


def flow_of(
    board: Board, middle: tuple[float, float], radius_mm: float, push: Array, soft: float, side: Array
) -> Array:
    """Outwards as `push` (t,) says, widest where the object ends; softer objects push more at their face; a shift."""
    away = lattice(board) - np.array(middle)
    r = np.linalg.norm(away, axis=-1) + 1e-9
    shape = np.exp(-(((r - radius_mm - 1) / 3) ** 2)) + soft * np.exp(-(((r - 0.7 * radius_mm) / 2) ** 2))
    out = (away / r[..., None] * shape[..., None])[None] * push[:, None, None, None]
    sunk = np.exp(-((r / 6) ** 2))[None, ..., None] * side[:, None, None, :]
    return np.asarray((out + sunk).reshape(len(push), -1) * PX_PER_MM)


def press(board: Board, rng: np.random.Generator, shape: str, radius_mm: float, shore_a: float) -> Press:
    """Twenty frames; a ball's flow grows wider as it sinks in."""
    n = 20
    depth = np.linspace(0.1, 1.9, n)
    middle = tuple(rng.uniform(-1, 1, 2).tolist())
    is_ball = shape == "sphere"
    wide = radius_mm * (np.sqrt(depth / 2) if is_ball else np.ones(n))
    side = np.outer(np.linspace(0, 0.1, n), rng.uniform(-1, 1, 2))
    soft = -1.5 if shape == "ring" else 0.8 * (1 - shore_a / 100)  # the gel comes back where there is no face
    parts = [
        flow_of(board, middle, float(w), 0.25 * depth[i : i + 1], soft, side[i : i + 1]) for i, w in enumerate(wide)
    ]
    flow = np.concatenate(parts) + rng.normal(size=(n, parts[0].shape[1])) * 0.01
    fn = 5 * depth * wide
    true = np.column_stack([20 * side[:, 0], 20 * side[:, 1], -fn, 0 * fn, 0 * fn, 0 * fn])
    force = true + np.outer(-fn, CROSSTALK) * [1, 1, 0, 1, 1, 1]
    center = np.tile(np.array(middle) * 1e3, (n, 1))
    radial = np.round(radial_um(board, flow, center) * 16).astype(np.int64)
    size = np.sqrt((radial**2).sum(axis=1)).astype(np.int64)
    area = np.pi * wide**2
    return Press(f"fit/{shape}{radius_mm}{shore_a}", "fit", shape, radius_mm, shore_a, flow, radial, size, size, center,
                 np.ones(n, np.bool_), force, depth * 1.1, depth, area)  # fmt: skip


@pytest.fixture(scope="module")
def presses(board: Board) -> list[Press]:
    rng = np.random.default_rng(1)
    return [press(board, rng, shape, radius, shore) for shape in ("flat", "square", "sphere")
            for radius in (5.0, 7.0, 9.0) for shore in (20.0, 50.0, 80.0)]  # fmt: skip


@pytest.fixture(scope="module")
def rings(board: Board) -> list[Press]:
    rng = np.random.default_rng(2)
    return [press(board, rng, "ring", radius, 40.0) for radius in (5.0, 7.0, 9.0)]


def test_symmetry_tells_the_references_crosstalk_from_shear(board: Board, presses: list[Press]) -> None:
    found = fit_contact_wrench(board, presses)
    assert found.crosstalk[:2] == pytest.approx(CROSSTALK[:2], abs=2e-3)
    assert found.crosstalk[5] == pytest.approx(1e3 * CROSSTALK[5], abs=0.1)
    new = press(board, np.random.default_rng(77), "flat", 6.0, 35.0)
    true = new.force - np.outer(new.force[:, 2], CROSSTALK) * [1, 1, 0, 1, 1, 1]
    said = found(new.flow)
    assert np.abs(said[:, :2] - true[:, :2]).max() < 0.1
    assert np.abs(said[:, 2] - true[:, 2]).max() < 0.06 * np.abs(true[:, 2]).max()


def test_each_axis_takes_the_part_of_a_flow_that_reflections_change_like_it(board: Board) -> None:
    shift = np.tile([1.0, 0.0], 34 * 26)[None]
    turn = (lattice(board) @ np.array([[0.0, 1.0], [-1.0, 0.0]])).reshape(1, -1)
    out = lattice(board).reshape(1, -1)
    for flow, axis in ((shift, 0), (out, 2), (turn, 5)):
        parts = [np.abs(symmetric(flow, (26, 34), k)).max() for k in (0, 1, 2, 5)]
        assert parts[(0, 1, 2, 5).index(axis)] == pytest.approx(np.abs(flow).max())
        assert sum(parts) == pytest.approx(np.abs(flow).max())


def test_depth_kind_and_hardness_of_objects_that_were_not_fitted(board: Board, presses: list[Press]) -> None:
    model = fit_model(board, Fitted.of(board, presses), n_seeds=1)
    for shape, shore in (("flat", 35.0), ("flat", 65.0), ("sphere", 35.0), ("sphere", 65.0)):
        new = press(board, np.random.default_rng(5), shape, 6.0, shore)
        told = tell(new, model)
        assert (told.signs[2] < 0.05) == (shape == "flat")  # only a ball's contact grows
        assert told.shore[0 if shape == "flat" else 1] == pytest.approx(shore, abs=12)
        force = model.wrench(new.flow)
        x = inputs_of(new.radial.astype(float), new.size.astype(float), -force[:, 2])
        depth = model.size(x)[:, 0] * new.size * 1e-3 / 16
        assert depth[5:] == pytest.approx(true_sizes(new)[5:, 0], abs=0.15)


def test_a_load_cell_teaches_the_normal_force_alone(
    board: Board, presses: list[Press], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ruffini.estimators.contact_model.tables.MOST_FOLDS", 2)
    monkeypatch.setattr("ruffini.estimators.contact_model.tables.FAILS_FOLDS", 2)
    monkeypatch.setattr("ruffini.estimators.contact_model.perceptron.MAX_STEPS", 20)
    monkeypatch.setattr("ruffini.estimators.contact_model.fit.N_BESIDE", 0)
    some = [p for p in presses if p.radius_mm < 8 and p.shore_a != 50]
    pressed = [replace(p, force=p.force * [0, 0, 1, 0, 0, 0]) for p in some]
    tensors, metadata = tables(board, fit_contact(board, pressed, lambda _: None), features_of(board))
    assert json.loads(metadata["residuals"])["wrench"]["not_measured"] == ["Fx", "Fy", "Tx", "Ty", "Tz"]
    assert np.flatnonzero(tensors["wrench.full_scale"]).tolist() == [2]


def test_tables_say_what_the_fit_says(
    board: Board, presses: list[Press], rings: list[Press], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ruffini.estimators.contact_model.tables.MOST_FOLDS", 2)
    monkeypatch.setattr("ruffini.estimators.contact_model.tables.FAILS_FOLDS", 2)
    monkeypatch.setattr("ruffini.estimators.contact_model.perceptron.MAX_STEPS", 150)
    fit = fit_contact(board, [*presses, *rings], lambda _: None)
    tensors, metadata = tables(board, fit, features_of(board))
    full = tensors["wrench.full_scale"]  # uN, and 1e-9 N m; nothing turns these presses
    assert full[5] == pytest.approx(0.02 * 5 * full[2], rel=1e-3)
    report = json.loads(metadata["residuals"])
    assert max(report["tables_err"].values()) < 6  # steps: of 1/4096 of a depth, um, 1/16 Shore A
    assert report["left_out_sizes"]["all"]["kind_right"] > 0.9
    assert set(tensors) >= {"contact_model.tanh", "contact_model.size_hidden", "wrench.gain"}
    assert "wrench.forward" not in tensors
    assert report["refused"]["ring"]["sizes"] >= 0.5  # of sizes that were not fitted, the largest of all among them
    assert all(tell(p, fit.model).fails < fit.most_failing for p in presses)
    assert 0 < int(metadata["contact_model.most_failing_q12"]) < 1 << 12
    assert int(metadata["contact_model.depth_sigma_um"]) > 1
    errors = [np.concatenate(left.wrench)[:, 2] for left in (fit.by_size, fit.by_shape)]
    loads = [np.abs(np.concatenate([p.force[:, 2] for p in left.presses])) for left in (fit.by_size, fit.by_shape)]
    for off, load in zip(errors, loads, strict=True):  # `cal check` lets a weight be off by three times these
        is_light = load < 0.15 * load.max()
        assert np.sqrt(np.mean(off[is_light] ** 2)) <= report["light_force_rms_n"] * (1 + 1e-9)
        assert np.sqrt(np.mean((off / load)[~is_light] ** 2)) <= report["force_rms_percent"] / 100 * (1 + 1e-9)
    allowed = CONTACT.allowed_n(report, 40.0)
    assert allowed == pytest.approx(3 * 0.4 * report["force_rms_percent"])
    judge_straight_presses(board, pack(tensors, {**base_metadata(board), **metadata}), presses[:2], tmp_path)


def judge_straight_presses(board: Board, file: CalibrationFile, presses: list[Press], folder: Path) -> None:
    """A report on a log that hardly loads the other axes: the normal force alone is judged."""
    touches = []
    for number, one in enumerate(presses):
        time_s = 10.0 * number + 0.1 * np.arange(len(one.flow))
        moved = one.flow.reshape(len(time_s), -1, 2).astype(np.float32)
        touches.append(TouchRecord({"session": "1"}, {
            "stream_s": time_s, "stream_host_s": time_s, "stream_frame": np.arange(len(time_s)),
            "stream_flags": np.zeros(len(time_s), int), "stream_wrench": np.full((len(time_s), 6), np.nan),
            "stream_validity": np.zeros((len(time_s), 6), int), "reference_s": time_s,
            "reference_wrench": one.force * [0.01, 0.01, 1, 0, 0, 0.01], "stage_s": time_s,
            "stage_place": np.zeros((len(time_s), 3)), "marker_s": time_s, "marker_displacement": moved,
        }))  # fmt: skip
    write_log(folder / "log.h5", Log({"board": board.name}, touches))
    assert reported_by(file) is CONTACT
    made = CONTACT.report(board, file, [folder / "log.h5"])
    assert [(gate.name, gate.ok) for gate in made.gates] == [("wrench Fz", True)]
    assert made.tree["axes"]["Fx"]["rmse"] > 0.1 * made.tree["axes"]["Fx"]["largest"]
    made.write_page(folder / "page.html")
    assert "Passes its gates" in (folder / "page.html").read_text()


def test_depth_of_a_log_without_a_simulations_truth(board: Board) -> None:
    """The travel less what the object gives way, next to nothing of a hard one; three quarters of it under balls."""
    of = {}
    for shape in ("flat", "sphere"):
        for shore in (20.0, 50.0, 98.0):
            one = press(board, np.random.default_rng(3), shape, 6.0, shore)
            of[shape, shore] = replace(one, force=0.1 * one.force).of_bench()
    for shape, part in (("flat", 1.0), ("sphere", 0.75)):
        hard, middle, soft = (of[shape, shore] for shore in (98.0, 50.0, 20.0))
        assert hard.known_gel_mm == pytest.approx(part * hard.travel_mm, rel=0.03)
        assert (soft.known_gel_mm < middle.known_gel_mm - 0.005)[3:].all()
        assert (middle.known_gel_mm < hard.known_gel_mm)[3:].all()
        assert soft.known_area_mm2 == pytest.approx(soft.effective_area_mm2)


def test_the_papers_moment_is_proportional_to_the_mean_flow(board: Board, presses: list[Press]) -> None:
    wrench = fit_contact_wrench(board, presses)
    turned = []
    for p in presses:
        mean_um = np.linalg.norm(p.flow.reshape(len(p.flow), -1, 2).mean(axis=1), axis=1) * 125.0
        force = p.force.copy()
        force[:, 5] = force[:, 2] * wrench.crosstalk[5] * 1e-3 - 2e-3 * mean_um  # N m: 2 N mm a um
        turned.append(replace(p, force=force))
    assert moment_per_flow(board, turned, wrench) == pytest.approx(2.0, rel=1e-6)


def test_a_perceptron_and_its_integers() -> None:
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, (800, 3))
    y = np.column_stack([np.sin(2 * x[:, 0]) * x[:, 1], x[:, 2] ** 2])
    net = Perceptron.mean_of([Perceptron.fit(x, y, decay=1e-6, seed=s) for s in range(2)])
    assert net.hidden.shape == (20, 4)
    assert np.abs(net(x) - y).std() < 0.05
    steps = np.full(3, 2.0**-14), np.array([1e-3, 2e-3])
    raw = np.round(x / steps[0]).astype(np.int64)
    said = run_tables({**net.tables("n", *steps), "t": tanh_table()}, "n", raw)
    assert np.abs(said * steps[1] - net(raw * steps[0])).max() < 3e-3


def test_a_log_without_a_bench_or_without_balls_is_refused(board: Board, presses: list[Press], tmp_path: Path) -> None:
    with pytest.raises(InputError, match='part "fit"'):
        read_presses([tmp_path], board)
    for text, why in (('{"part": "fit"}', "no run of a bench"), ("{bad", "no JSON"), ("[1]", "says nothing of a run"),
                      ('{"part": "fit", "chosen": 3}', "no run of a bench")):  # fmt: skip
        (tmp_path / "run.json").write_text(text)
        with pytest.raises(InputError, match=why):
            read_presses([tmp_path], board)
    (tmp_path / "run.json").write_text('{"part": "fit", "chosen": {"indenter": "flat", "radius_um": 5000}}')
    arrays = {"force": np.zeros((4, 6)), "depth_m": np.zeros(4), "shore_a": np.array(50.0)}
    for name, value, why in (("force", np.full((4, 6), np.nan), "finite"), ("depth_m", np.zeros(3), "depth_m"),
                             ("shore_a", np.zeros(2), "no run of a bench")):  # fmt: skip
        np.savez(tmp_path / "rig.npz", **(arrays | {name: value}))
        with pytest.raises(InputError, match=why):
            read_presses([tmp_path], board)
    (tmp_path / "rig.npz").write_bytes(b"PK\x03\x04 cut off")
    with pytest.raises(InputError, match="no run of a bench"):
        read_presses([tmp_path], board)
    with pytest.raises(InputError, match="balls"):
        fit_model(board, Fitted.of(board, [p for p in presses if not p.is_hertzian]))
