"""The table of estimators, in the order in which one needs what another found. A new one is one more line."""

from __future__ import annotations

from ruffini.boards import Board
from ruffini.calibrate.container import CalibrationFile
from ruffini.errors import InputError
from ruffini.estimators.base import Estimator
from ruffini.estimators.camera.stage import CAMERA
from ruffini.estimators.contact_model.stage import CONTACT
from ruffini.estimators.dark.stage import DARK
from ruffini.estimators.fingertip.stage import FINGERTIP
from ruffini.estimators.material.stage import MATERIAL
from ruffini.estimators.noise.stage import NOISE
from ruffini.estimators.operator.stage import OPERATOR
from ruffini.estimators.operator.task import TASK as FORCES
from ruffini.estimators.photometric.stage import PHOTOMETRIC
from ruffini.estimators.relaxation.stage import RELAXATION
from ruffini.estimators.skin.stage import SKIN
from ruffini.estimators.task import Task, Turned
from ruffini.estimators.threshold.stage import THRESHOLD
from ruffini.estimators.wrench.stage import WRENCH
from ruffini.rig.program import Span, span_of

ESTIMATORS: tuple[Estimator, ...] = (
    CAMERA,
    DARK,
    PHOTOMETRIC,
    MATERIAL,
    RELAXATION,
    NOISE,
    OPERATOR,
    THRESHOLD,
    CONTACT,
    WRENCH,
    SKIN,
    FINGERTIP,
)
BY_NAME = {estimator.name: estimator for estimator in ESTIMATORS}


def applying(board: Board) -> tuple[Estimator, ...]:
    """Those that a board's stages use."""
    return tuple(estimator for estimator in ESTIMATORS if estimator.applies(board))


def need_prior_stage(board: Board, only: str | None, skip: frozenset[str], *, is_calibration: bool) -> None:
    """Refuse a fleet's numbers, or a calibration of other units, where no stage of a fit begins with them.

    Raises
    ------
    InputError
        The board, `only` or `skip` leaves out every stage that does.
    """

    def takes(stage: Estimator) -> bool:
        return stage.fits_from_calibration if is_calibration else stage.fits_from_prior

    stages = applying(board) if only is None else (BY_NAME[only],)
    if any(takes(stage) and stage.name not in skip for stage in stages):
        return
    names = ", ".join(stage.name for stage in ESTIMATORS if takes(stage))
    what = "a calibration of other units" if is_calibration else "the numbers of a fleet's pads"
    raise InputError(
        f"--prior: only stage {names} begins with {what}, and this fit of board {board.name!r} does not run it: leave "
        "the option out"
    )


def task_of(board: Board) -> Task | Turned:
    """What a bench presses to calibrate a board.

    Raises
    ------
    InputError
        It has no estimator that can be fitted.
    """
    for estimator in applying(board):
        if (task := estimator.task_of(board)) is not None:
            return task
    raise InputError(f"board {board.name!r} has no estimator yet that `cal auto` could fit: its stages "
                     f"({', '.join(board.pipeline.stages)}) make no force, no wrench, no skin's contacts")  # fmt: skip


def pressed_for(board: Board, *, is_simulated: bool = False) -> Task:
    """The task whose depth, shear and ball suit a board: its estimator's, or that of forces if a bench presses none."""
    for estimator in applying(board):
        task = estimator.task_of(board)
        if isinstance(task, Turned) and not is_simulated:
            return task.bench
        if isinstance(task, Task):
            return task
    return FORCES


def scale_span(board: Board) -> Span:
    """Where a person presses to calibrate a board with a kitchen scale.

    Raises
    ------
    InputError
        The board is fitted to something else.
    """
    task = task_of(board)
    if not isinstance(task, Task) or task.scale_part is None:
        raise InputError(f"board {board.name!r} needs more than presses on a kitchen scale: see "
                         "docs/how-to/calibrate-your-pad.md")  # fmt: skip
    return span_of(board, 1e-3 * task.depth_mm, 0.0).inside(task.scale_part)


def how_calibrated(board: Board) -> str:
    """What calibrates a unit that is connected, for a person.

    Raises
    ------
    InputError
        As `task_of`.
    """
    task = task_of(board)
    if isinstance(task, Task) and task.scale_part is not None:
        return "with Calibrate in the page, or `ruffini cal auto`"
    return "by `ruffini cal auto`"


def needs_ball_first(board: Board) -> bool:
    """True if a board without a calibration learns its colours from a ball."""
    return any(estimator.first_program for estimator in applying(board))


def reported_by(file: CalibrationFile) -> Estimator:
    """The estimator that judges a file.

    Raises
    ------
    InputError
        None of them does.
    """
    for estimator in ESTIMATORS:
        if estimator.is_reported and estimator.kinds[0] in file.kinds:
            return estimator
    kinds = ", ".join(estimator.kinds[0] for estimator in ESTIMATORS if estimator.is_reported)
    raise InputError(f"this calibration has no {kinds}: there are no forces to judge")
