"""Whether a calibration is good enough to be flashed: each gate a number, a limit and a sentence.

Gates are judged by touch, each touch by a fit that did not see it, and on the board's own integers. They travel in the
file's manifest, so that `ruffini cal flash` can refuse a file wherever it comes from.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate.container import FAILED, PASSED, CalibrationFile
from ruffini.calibrate.fit.job import HELD_S, Outcome, left_after
from ruffini.calibrate.log.touches import TouchLog
from ruffini.core.pipeline import DISPLACEMENT_LSB_M, Pipeline
from ruffini.estimators.material.fit import MIN_TOUCHES, MaterialFit
from ruffini.estimators.material.stage import left_out_figures
from ruffini.estimators.operator.error_model import node_places
from ruffini.estimators.operator.fit import Material, board_slab
from ruffini.estimators.skin.judge import REFERENCE, SAID
from ruffini.files import readable

Array = npt.NDArray[np.float64]

MIN_PRESSES = 10  # without a fleet or a previous calibration behind it
MIN_COVERAGE = 0.5  # of CELLS x CELLS parts of the window: what was never pressed is not calibrated
CELLS = 3
MAX_ERROR = 0.05  # of the largest force: 95th percentile of touches left out; the main job's own limit
MAX_GAIN_ERROR = 0.03
MAX_INTERVAL = 0.10  # of E, 95 %, half width
MAX_WORSE = 1.10  # times the previous calibration's error on the same touches
MAX_REST_N = 0.02  # force of an untouched frame, 99th percentile
MAX_WRENCH_ERROR = 0.10  # of what an axis was loaded with: RMS on what was left out
MAX_SKIN_ERROR = 0.10  # of a press left out above 2 N, mean: what brightness alone does without taxels
HARD_N = 2.0  # below, a skin's force is judged in newtons by what the calibration states, not as a part
MAX_SKIN_PLACE = 0.5  # of the distance of two openings, mean: nearer to the right one than to the next
MAX_GEL_MM = 0.2  # a contact model's gel depth: the paper's own uncertainty of it
MAX_SHORE_A = 16.0  # its hardness: twice what the paper has, since few presses begin with more
MIN_KIND = 0.8  # of presses whose kind, planar or Hertzian, is told right
MAX_NORMAL_DEG = 7.0  # of ball presses left out, median: what recorded presses of a good unit reach

MIN_PLACES = 3  # forty copies of one press are one press
MAX_CAP = 0.05  # of the ball's diameter
MAX_SCALE = 1.3  # times the board's pixels a millimetre: mounting and lens of a unit differ by less
MAX_CAMERA_PX = 1.0
MAX_DARK = 64.0  # grey levels
MAX_MODULUS = 2.0  # times the board's: batches of a gel differ by less, units of force by more
UNITS = {"lbf": 4.448, "kgf": 9.807, "mN": 1e-3}  # newtons
SAME_UNIT = 0.25  # a modulus that a wrong unit explains so well


class Gate(NamedTuple):
    """One condition; `ok` is None where it could not be judged (it does not refuse then)."""

    name: str
    ok: bool | None
    value: float | None
    limit: float | None
    text: str


class Judged(NamedTuple):
    """What a calibration makes of a log: wrench of each held frame (t, 6), force of each untouched one (k, 3)."""

    wrench: Array
    rest_n: Array


def judged(board: Board, file: CalibrationFile, log: TouchLog) -> Judged | None:
    """The board's own integers on a log's displacements; None where the file has no operator."""
    if "operator" not in file.kinds:
        return None
    places = node_places(board_slab(board), board.observed)
    shape = (len(places.y_m), len(places.x_m), 3)
    # Single frames carry no time: what a held touch has lost by then is taken off as a whole.
    left = left_after(file.tensors, HELD_S)
    with Pipeline(board, file.data) as pipeline:

        def forces(u: Array) -> Array:
            steps = np.clip(np.round(u / DISPLACEMENT_LSB_M), -32767, 32767).astype(np.int16)
            lsb_n = board.field.force_lsb_un * 1e-6
            return np.asarray(pipeline.solve(steps) * (lsb_n * left)).reshape(len(u), *shape)

        wrench = [places.wrench(f, np.zeros(2)) for f in forces(log.displacement)]
        rest = forces(log.rest).sum(axis=(1, 2)) if len(log.rest) else np.zeros((0, 3))
    return Judged(np.array(wrench), rest)


def gates_of(
    board: Board, log: TouchLog, outcomes: dict[str, Outcome], fit: MaterialFit | None, now: Judged | None,
    previous: Judged | None,
) -> list[Gate]:  # fmt: skip
    """All that can be judged of a fit."""
    gates = [*_of_log(board, log, fit), *gates_of_reference(log.found)]
    if fit is not None:
        gates += _of_material(fit) + gates_of_modulus(fit.material, board)
    if now is not None:
        gates += _of_forces(log, now, previous)
    return gates + gates_of_stages(outcomes)


def gates_of_stages(outcomes: dict[str, Outcome]) -> list[Gate]:
    """What stages say of themselves, on what they left out of their own fits."""
    gates = []
    colours, wrench, skin, contact = (outcomes.get(name) for name in ("photometric", "wrench", "skin", "contact"))
    if colours is not None and "held_out_normal_median_deg" in colours.report:
        value = float(colours.report["held_out_normal_median_deg"])
        gates.append(_at_most("normals", value, MAX_NORMAL_DEG, "deg, median of ball presses left out"))
    if wrench is not None and "axes" in wrench.report:
        for name, axis in wrench.report["axes"].items():
            if axis["full_scale"]:
                part = axis["rmse"] / abs(axis["full_scale"])
                gates.append(_part(f"wrench {name}", part, MAX_WRENCH_ERROR, "of full scale: RMS left out"))
    if skin is not None and "n_presses" in skin.report:
        gates += _of_skin(skin.report)
    if contact is not None and "left_out_sizes" in contact.report:
        gates += _of_contact(contact.report)
    return gates


def _of_contact(report: dict[str, Any]) -> list[Gate]:
    """Of a contact model: each size judged by a fit without it."""
    left = report["left_out_sizes"]["all"]
    part = left["normal_n"] / report["largest_n"]
    return [
        _at_least("presses", report["n_presses"], MIN_PRESSES, "presses"),
        _part("contact force", part, MAX_WRENCH_ERROR, "of the largest normal force: RMS of sizes left out"),
        _at_most("contact depth", left["gel_depth_mm"], MAX_GEL_MM, "mm, RMS of sizes left out"),
        _at_most("contact hardness", left["shore_a"], MAX_SHORE_A, "Shore A, RMS of sizes left out"),
        _at_least("contact kind", left["kind_right"], MIN_KIND, "of the presses left out told right"),
    ]


def _of_skin(report: dict[str, Any]) -> list[Gate]:
    """Of a glowing skin: each press judged by a fit without it."""
    force, place = report["force_error_percent"] / 100, report["place_error_mm"] / report["pitch_mm"]
    n, n_at_rim, remedy = report["n_presses"], report["n_at_rim"], ""
    if force > MAX_SKIN_ERROR and 2 * n_at_rim > n:
        remedy = f"; {n_at_rim} of {n} presses are at a rim, where a panel's edge bears too: press inside as often"
    return [
        _at_least("touches", n, MIN_PRESSES, "touches"),
        _covered(report["coverage"], "of the skin's parts"),
        _part("skin force", force, MAX_SKIN_ERROR, f"of the force: mean of presses left out, above 2 N{remedy}"),
        _part("skin place", place, MAX_SKIN_PLACE, "of the openings' distance: mean of presses left out"),
    ]


def _at_most(name: str, value: float, limit: float, what: str) -> Gate:
    return Gate(name, bool(value <= limit), value, limit, f"{value:.3g} {what}, at most {limit:.3g}")


def _part(name: str, value: float, limit: float, what: str) -> Gate:
    """At most so large a part, said in per cent."""
    return Gate(name, bool(value <= limit), value, limit, f"{100 * value:.2g} % {what}, at most {100 * limit:.3g} %")


def _covered(value: float, what: str) -> Gate:
    return Gate("coverage", bool(value >= MIN_COVERAGE), value, MIN_COVERAGE,
                f"{100 * value:.0f} % {what} pressed, at least {100 * MIN_COVERAGE:.0f} %")  # fmt: skip


def _at_least(name: str, value: float, limit: float, what: str) -> Gate:
    return Gate(name, bool(value >= limit), value, limit, f"{value:.3g} {what}, at least {limit:.3g}")


def contact_places(board: Board, log: TouchLog) -> Array:
    """Where each touch dents the pad most, (touches, 2) m from the pad's centre; depth (m) as third column."""
    places = node_places(board_slab(board), board.observed)
    x, y = np.meshgrid(places.x_m, places.y_m)
    rows = []
    for t in np.unique(log.touch):
        dent = np.maximum(-log.displacement[np.flatnonzero(log.touch == t)[-1]][:, 2], 0)
        weight = np.where(dent > 0.5 * dent.max(), dent, 0)
        total = max(float(weight.sum()), 1e-12)
        rows.append((float(weight @ x.ravel()) / total, float(weight @ y.ravel()) / total, float(dent.max())))
    return np.array(rows)


def coverage(board: Board, places: Array) -> npt.NDArray[np.int64]:
    """Touches in each of CELLS x CELLS parts of the middle of the window, (rows, columns)."""
    pad, window = board.pad, board.window
    half = np.array([min(pad.size_x_um / 2 - window.min_x_um, window.max_x_um - pad.size_x_um / 2),
                     min(pad.size_y_um / 2 - window.min_y_um, window.max_y_um - pad.size_y_um / 2)]) * 1e-6  # fmt: skip
    # Presses keep clear of the rim, so its part of the window counts to the cells inside it.
    cell = np.clip(((places[:, :2] / (0.75 * half) + 1) / 2 * CELLS).astype(int), 0, CELLS - 1)
    count = np.zeros((CELLS, CELLS), np.int64)
    np.add.at(count, (cell[:, 1], cell[:, 0]), 1)
    return count


def _of_log(board: Board, log: TouchLog, fit: MaterialFit | None) -> list[Gate]:
    informed = fit is not None and fit.prior.is_informed
    gates = [_at_least("touches", log.n_touches, 1 if informed else MIN_PRESSES, "touches")]
    if not informed:
        covered = float((coverage(board, contact_places(board, log)) > 0).mean())
        gates.append(_covered(covered, "of the pad's parts"))
    return gates


def gates_of_skin(rows: Array) -> list[Gate]:
    """On the board's integers: `rows` as of `judged_presses`, those above 2 N."""
    hard = rows[rows[:, REFERENCE] > HARD_N]
    if not len(hard):
        return [Gate("on the board", None, None, None, f"no picture of the log is pressed with more than {HARD_N:g} N")]
    part = np.abs(hard[:, SAID] / hard[:, REFERENCE] - 1)
    return [_part("on the board", float(part.mean()), MAX_SKIN_ERROR, "of the force: mean of the board's integers")]


def gates_of_reference(of_logs: list[dict[str, Any]]) -> list[Gate]:
    """What `cal collect` checked of the reference; `of_logs`: the `found` of each."""
    gates = []
    for found in of_logs:
        for name, check in found.get("checks", {}).items():
            if isinstance(check, dict) and "ok" in check:
                gates.append(Gate(f"reference {name}", check["ok"], None, None, str(check.get("text", ""))))
    return gates


def gates_of_material(fit: MaterialFit, board: Board) -> list[Gate]:
    """Gates of a `cal fit --only material` run, without the rest of a calibration."""
    return _of_material(fit) + gates_of_modulus(fit.material, board)


def _of_material(fit: MaterialFit) -> list[Gate]:
    gates = [_part("interval of E", float(fit.interval[0] / fit.values[0]), MAX_INTERVAL, "of E, 95 %")]
    if fit.n_touches < MIN_TOUCHES:
        return gates  # nothing to leave out: the prior's word counts
    figures = left_out_figures(fit)
    part = figures["force_p95_n"] / figures["largest_force_n"]
    return [
        *gates,
        _part("error", part, MAX_ERROR, "of the largest force: 95th percentile of touches left out"),
        _part("gain", abs(figures["gain"] - 1), MAX_GAIN_ERROR, "off in the size of forces left out"),
    ]


def _of_forces(log: TouchLog, now: Judged, previous: Judged | None) -> list[Gate]:
    error = force_rmse_n(log, now.wrench)
    largest = float(np.nanmax(np.abs(log.wrench[:, :3])))
    gates = [_part("on the board", error / largest, MAX_ERROR, "of the largest force: RMS of the board's integers")]
    if previous is not None:
        ratio = error / max(force_rmse_n(log, previous.wrench), 1e-9)
        gates.append(_at_most("against the previous", ratio, MAX_WORSE, "times the previous calibration's error"))
    if len(now.rest_n):
        quiet = float(np.percentile(np.linalg.norm(now.rest_n, axis=1), 99))
        gates.append(_at_most("rest", quiet, MAX_REST_N, "N said of untouched frames, 99th percentile"))
    return gates


def force_rmse_n(log: TouchLog, wrench: Array) -> float:
    """Root mean square over touches of the force's error, of what the reference measures."""
    seen = np.isfinite(log.wrench[:, :3]).all(axis=0)
    error = (wrench - log.wrench)[:, :3][:, seen]
    by_touch = [np.linalg.norm(error[log.touch == t].mean(axis=0)) for t in np.unique(log.touch)]
    return float(np.sqrt(np.mean(np.square(by_touch))))


def failed(gates: Sequence[Gate]) -> list[Gate]:
    """Those that refuse."""
    return [gate for gate in gates if gate.ok is False]


def manifest_of(report: dict[str, Any], gates: Sequence[Gate]) -> dict[str, str]:
    """`residuals` and `gates` of a manifest: the report's figures, and PASSED or what failed (proto/CALIBRATION.md)."""
    tree = {**report, "gates": [gate._asdict() for gate in gates]}
    return {"residuals": json.dumps(tree), **({"gates": verdict(gates)} if gates else {})}


def verdict(gates: Sequence[Gate]) -> str:
    """PASSED, or the names of the gates that failed, as a manifest has it."""
    bad = failed(gates)
    return FAILED + ", ".join(gate.name for gate in bad) if bad else PASSED


def gates_of_presses(report: dict[str, Any]) -> list[Gate]:
    """Of ball presses (`cal fit --only photometric`): normals or depth of presses left out, number of places."""
    gates = [_at_least("places", report["n_places"], MIN_PLACES, "different places or depths")]
    if "held_out_normal_median_deg" in report:
        gates += gates_of_stages({"photometric": Outcome("fitted", "", report)})
    elif (held_out := report.get("held_out_cap_rms_mm")) is not None:
        part = held_out / report["ball_mm"]
        gates.append(_part("depth", part, MAX_CAP, "of the ball's diameter: RMS of presses left out"))
    else:
        gates.append(Gate("depth", None, None, None, "one press: none can be left out"))
    if report.get("scale_of_board") is not None:
        gates.append(_near("scale", report["scale_of_board"], MAX_SCALE, "of the board's pixels a millimetre"))
    return gates


def gates_of_noise(report: dict[str, Any], board: Board) -> list[Gate]:
    """Of `cal fit --only touch`: what it takes for a touch is no more than the board's own threshold."""
    return [_at_most("touch noise", report["alone_mn"], board.contact.threshold_un * 1e-3, "mN on one node")]


def gates_of_camera(report: dict[str, Any]) -> list[Gate]:
    """Of `cal fit --only camera`, of one view or several."""
    views = report["views"] if isinstance(report["views"], list) else [report]
    worst = max(view["residual_px"] for view in views)
    return [_at_most("camera", worst, MAX_CAMERA_PX, "px RMS of the target's points")]


def gates_of_dark(report: dict[str, Any]) -> list[Gate]:
    """Of `cal fit --only dark`."""
    return [_at_most("dark level", max(report["level_bgr"]), MAX_DARK, "grey levels with the lamps off")]


def gates_of_relaxation(report: dict[str, Any]) -> list[Gate]:
    """Of `cal fit --only relaxation`."""
    left = report["rmse_after_n"] / max(report["rmse_before_n"], 1e-9)
    return [
        _at_most("relaxation", left, 1.0, "times the force error without it"),
        _near("relaxation gain", report["gain"], MAX_MODULUS, "of the calibration's force"),
    ]


def gates_of_fit_file(path: Path) -> list[Gate] | None:
    """What a file of `cal fit --only material` or `relaxation` says of its gates; None where it says nothing."""
    try:
        return [Gate(**row) for row in json.loads(readable(path).read_text())["gates"]]
    except (OSError, ValueError, KeyError, TypeError):
        return None


def gates_of_tip(report: dict[str, Any]) -> list[Gate]:
    """Of `cal fit --only fingertip`."""
    off = report["mean_error_of_presses_left_out"]["both"]["force_n"]
    return [
        _at_least("presses", report["n_presses"], MIN_PRESSES, "presses"),
        _part("fingertip force", off / report["largest_n"], MAX_WRENCH_ERROR, "of the largest force: mean left out"),
    ]


def gates_of_modulus(material: Material, board: Board) -> list[Gate]:
    """The pad's E against the board's: a reference in another unit, or another pad."""
    modulus_pa = board_slab(board).modulus_pa
    ratio = material.modulus_pa / modulus_pa
    unit = next((name for name, n in UNITS.items() if abs(ratio * n - 1) < SAME_UNIT), "")
    hint = f"; is the reference in {unit}?" if unit else "; is its unit N, and is it this board's pad?"
    gate = _near("modulus", ratio, MAX_MODULUS, f"of the board's {modulus_pa / 1e3:.0f} kPa")
    return [gate if gate.ok else gate._replace(text=gate.text + hint)]


def _near(name: str, value: float, factor: float, what: str) -> Gate:
    """Within a factor of 1, either way."""
    return Gate(name, bool(1 / factor <= value <= factor), value, factor,
                f"{value:.3g} times that {what}, from {1 / factor:.2g} to {factor:.3g} times")  # fmt: skip


def gates_in(file: CalibrationFile) -> list[Gate] | None:
    """What a file's manifest says of its gates; None where it says nothing."""
    try:
        tree: Any = json.loads(file.metadata.get("residuals", "{}"))
        rows = tree.get("gates") if isinstance(tree, dict) else None
        return None if rows is None else [Gate(**row) for row in rows]
    except (ValueError, TypeError):
        return None
