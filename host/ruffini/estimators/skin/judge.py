"""What a skin's calibration makes of a log's pictures, on the board's own integers, beside the reference."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate.container import CalibrationFile
from ruffini.calibrate.gates import HARD_N, Gate, part
from ruffini.core.pipeline import Pipeline
from ruffini.errors import InputError
from ruffini.estimators.skin.log import PicturedPress, pictured_presses, read_skin_log, whole
from ruffini.estimators.skin.presses import TOUCHED_N, Progress

Array = npt.NDArray[np.float64]

TOUCH, REFERENCE, SAID, PLACE_X, PLACE_Y, OFF_X, OFF_Y = range(7)  # columns: number, N, N, mm
MAX_SKIN_ERROR = 0.10  # of a press left out above 2 N, mean: what brightness alone does without taxels
APART_S = 1000.0  # from press to press: what the skin remembers is gone by then


def judged_presses(
    board: Board, file: CalibrationFile, paths: list[Path], progress: Progress = lambda _: None
) -> Array:
    """A row for each pressed picture, (n, 7): force (N) of reference and sensor, place and how far off the sensor is.

    A press that the sensor does not tell is 0 N, its place NaN.

    Raises
    ------
    InputError
        No log, another board's, or one without pictures of presses.
    """
    rows: list[Array] = []
    n_presses = 0
    with Pipeline(board, file.data) as pipeline:
        for i, path in enumerate(paths):
            if path.suffix != ".h5":
                raise InputError(f"{path}: a skin is judged on logs of `cal collect` (.h5)")
            log = read_skin_log(path, board)
            for n, press in enumerate(pictured_presses(log, path.name, board)):
                rows += _judged(pipeline, board, press, n_presses)
                n_presses += 1
                progress((i + (n + 1) / len(log.touches)) / len(paths))
    if not rows:
        raise InputError("the logs hold no pictures of presses: there is nothing to judge")
    return np.array(rows)


def _judged(pipeline: Pipeline, board: Board, press: PicturedPress, number: int) -> list[Array]:
    start_s = APART_S * (number + 1) - press.time_s[0]
    pictures = [whole(picture, press.step_px, board) for picture in press.pictures[press.n_rest - 1 :]]
    rest = pictures[0]
    pipeline.set_rest(rest)
    pipeline.process(rest, start_s + press.time_s[press.n_rest - 1] - 1e-3)
    pipeline.process(rest, start_s + press.touched_s)
    rows = []
    after = slice(press.n_rest, None)
    for picture, time_s, force_n in zip(pictures[1:], press.time_s[after], press.force_n[after], strict=True):
        pipeline.process(picture, start_s + time_s)
        touches = pipeline.touches()
        if force_n > TOUCHED_N:
            said = (touches[0].press_un * 1e-6, touches[0].x_um * 1e-3, touches[0].y_um * 1e-3) if touches else None
            force, *place = said or (0.0, np.nan, np.nan)
            off = np.array(place) - press.place_mm
            if board.skin is not None and board.skin.shape == "tube":
                round_mm = board.pad.size_x_um * 1e-3
                off[0] = (off[0] + round_mm / 2) % round_mm - round_mm / 2
            rows.append(np.array([number, force_n, force, *press.place_mm, *off]))
    return rows


def gates_of_skin(rows: Array) -> list[Gate]:
    """On the board's integers: `rows` as of `judged_presses`, those above HARD_N."""
    hard = rows[rows[:, REFERENCE] > HARD_N]
    if not len(hard):
        return [Gate("on the board", None, None, None, f"no picture of the log is pressed with more than {HARD_N:g} N")]
    off = np.abs(hard[:, SAID] / hard[:, REFERENCE] - 1)
    return [part("on the board", float(off.mean()), MAX_SKIN_ERROR, "of the force: mean of the board's integers")]
