"""What a calibration makes of a log's displacements, on the board's own integers, and its gates."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate.container import CalibrationFile
from ruffini.calibrate.fit.job import HELD_S
from ruffini.calibrate.gates import (
    MAX_ERROR,
    MAX_REST_N,
    MIN_PRESSES,
    Gate,
    at_least,
    at_most,
    covered,
    part,
)
from ruffini.calibrate.log.touches import TouchLog
from ruffini.core.pipeline import DISPLACEMENT_LSB_M, Pipeline
from ruffini.estimators.operator.error_model import node_places
from ruffini.estimators.operator.fit import board_slab
from ruffini.estimators.relaxation.fit import left_after
from ruffini.rig.program import span_of

Array = npt.NDArray[np.float64]

CELLS = 3
MAX_WORSE = 1.10  # times the previous calibration's error on the same touches


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


def gates_of_touches(board: Board, log: TouchLog, *, is_informed: bool) -> list[Gate]:
    """Enough touches, all over the pad; one where a fleet or a previous calibration informs the fit."""
    gates = [at_least("touches", log.n_touches, 1 if is_informed else MIN_PRESSES, "touches")]
    if not is_informed:
        pressed = float((coverage(board, contact_places(board, log)) > 0).mean())
        gates.append(covered(pressed, "of the pad's parts"))
    return gates


def gates_of_forces(board: Board, log: TouchLog, now: Judged, previous: Judged | None) -> list[Gate]:
    """The board's forces against the log's, and against those of the calibration before.

    At rest only axes count that the board states to measure: depth whose constant is gauged by a narrow ring of the
    window moves the normal force of an untouched pad by tens of millinewtons.
    """
    error = force_rmse_n(log, now.wrench)
    largest = float(np.nanmax(np.abs(log.wrench[:, :3])))
    gates = [part("on the board", error / largest, MAX_ERROR, "of the largest force: RMS of the board's integers")]
    if previous is not None:
        ratio = error / max(force_rmse_n(log, previous.wrench), 1e-9)
        gates.append(at_most("against the previous", ratio, MAX_WORSE, "times the previous calibration's error"))
    axes = [i for i, axis in enumerate("xyz") if f"force_{axis}" not in board.board.not_measured]
    if len(now.rest_n) and axes:
        quiet = float(np.percentile(np.linalg.norm(now.rest_n[:, axes], axis=1), 99))
        of = "" if len(axes) == len("xyz") else f" along {' and '.join('xyz'[i] for i in axes)}"
        gates.append(at_most("rest", quiet, MAX_REST_N, f"N said of untouched frames{of}, 99th percentile"))
    return gates


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
    # Presses keep clear of the rim, so its part of the window counts to the cells inside it.
    half_m = np.array(span_of(board, 0.0, 0.0)[:2])
    cell = np.clip(((places[:, :2] / half_m + 1) / 2 * CELLS).astype(int), 0, CELLS - 1)
    count = np.zeros((CELLS, CELLS), np.int64)
    np.add.at(count, (cell[:, 1], cell[:, 0]), 1)
    return count


def force_rmse_n(log: TouchLog, wrench: Array) -> float:
    """Root mean square over touches of the force's error, of what the reference measures."""
    seen = np.isfinite(log.wrench[:, :3]).all(axis=0)
    error = (wrench - log.wrench)[:, :3][:, seen]
    by_touch = [np.linalg.norm(error[log.touch == t].mean(axis=0)) for t in np.unique(log.touch)]
    return float(np.sqrt(np.mean(np.square(by_touch))))
