"""What a fit works on, and how an estimator's part of it ends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate import container
from ruffini.calibrate.container import CalibrationFile, Tensors
from ruffini.calibrate.log.touches import TouchLog, read_touch_log
from ruffini.errors import InputError
from ruffini.estimators.material.fit import MaterialFit
from ruffini.estimators.material.prior import Prior, board_prior, is_of_finite_strain, next_gel_prior
from ruffini.estimators.operator.fit import Material
from ruffini.estimators.relaxation.fit import left_after
from ruffini.fem.operators import Noise

Array = npt.NDArray[np.float64]
Progress = Callable[[float], None]
# fitted: on this log. given: a file of another verb. kept: the previous calibration's. board: board.toml's numbers.
# open: the log does not tell it, and nothing stands in.
HELD_S = 0.5  # from a touch to the frames that its fit uses: of the order of the rig's hold
State = Literal["fitted", "given", "kept", "board", "open"]


class Outcome(NamedTuple):
    """How an estimator's fit ended, in one line, and its residuals for the report.

    details : its tables, for a person. remarks : on the log and on what the fit left out. files : written besides.
    """

    state: State
    text: str
    report: dict[str, Any] = {}  # noqa: RUF012 - never written to
    details: str = ""
    remarks: tuple[str, ...] = ()
    files: tuple[Path, ...] = ()


@dataclass
class Job:
    """Inputs of a fit, and what its estimators have found so far."""

    found: Board | None  # None: a log of named columns, of a sensor that no board describes
    paths: list[Path]
    previous: CalibrationFile | None = None
    parts: list[CalibrationFile] = field(
        default_factory=list
    )  # of `cal fit --only camera`, `cal fit --only photometric`
    balls: Path | None = None
    fleet: Prior | None = None
    other_units: CalibrationFile | None = None  # fitted to logs of other units of this board
    is_finite: bool = False
    n_error_touches: int = 0
    points: Path | None = None  # known points of a tube's lens
    baseline_mm: float | None = None  # between the two eyes of a fingertip
    only: str | None = None  # name of the one estimator that is fitted
    options: Any = None  # its own, of its `Command`
    pattern: str = "*"  # of the folders of presses that are used

    tensors: Tensors = field(default_factory=dict)
    metadata: dict[str, str] = field(default_factory=dict)
    material: Material | None = None  # None: the board's
    stiffness_sigma: float | None = None  # relative, of its force; None: what make_operator takes
    fit: MaterialFit | None = None
    has_new_colours: bool = False  # a log measured with other ones is computed again from its pictures
    instant_gain: float = 1.0  # E at the instant over the fitted one, which is that of a held touch
    noise: Noise | None = None
    matrix: Array | None = None  # float64 of the operator
    _log: TouchLog | None = None

    @property
    def board(self) -> Board:
        """The board that is calibrated.

        Raises
        ------
        InputError
            None was named.
        """
        if self.found is None:
            raise InputError("no board: give --board, or --previous with a calibration of it")
        return self.found

    def log(self, progress: Progress = lambda _: None) -> TouchLog:
        """The touches; recordings are seen with the camera and the colours found so far."""
        if self._log is None:
            colours = container.pack(self.tensors, self.header()) if self.tensors else None
            self._log = read_touch_log(
                self.paths, self.board, colours, from_pictures=self.has_new_colours, progress=progress
            )
        return self._log

    def path(self) -> Path:
        """The one path that was given.

        Raises
        ------
        InputError
            There are several.
        """
        if len(self.paths) != 1:
            raise InputError(f"{', '.join(map(str, self.paths))}: stage {self.only} is fitted to one of them: give one")
        return self.paths[0]

    def logs(self) -> list[Path]:
        """Those of `cal collect`, of all paths."""
        return [path for path in self.paths if path.suffix == ".h5"]

    def seen_with(self) -> CalibrationFile:
        """The calibration before, which makes displacement and force of a recording's pictures.

        Raises
        ------
        InputError
            None was given.
        """
        if self.previous is None:
            raise InputError(f"stage {self.only} sees a recording with this unit's calibration: give --previous FILE")
        return self.previous

    def prior(self) -> Prior:
        """What is believed of the pad: the fleet's, else the previous calibration's, else the board's numbers."""
        if self.fleet is not None:
            return self.fleet
        before = material_of(self.previous)
        if before is None or self.previous is None:
            return board_prior(self.board)
        return next_gel_prior(before, is_finite=is_of_finite_strain(self.previous))

    def header(self) -> dict[str, str]:
        """Metadata of a file with what was found so far."""
        base = container.metadata_without_board() if self.found is None else container.base_metadata(self.found)
        return {**base, **self.metadata}

    def take(self, kind: str) -> Outcome | None:
        """Copy a kind out of a file that was given, else out of the previous calibration; None where neither has it."""
        states: tuple[tuple[State, CalibrationFile | None], ...] = (
            *(("given", part) for part in reversed(self.parts)), ("kept", self.previous),
        )  # fmt: skip
        for state, file in states:
            if file is not None and kind in file.kinds:
                self.tensors |= {k: v for k, v in file.tensors.items() if k.split(".")[0] == kind}
                self.metadata |= {k: v for k, v in file.metadata.items() if k.split(".")[0] == kind}
                if container.KINDS[kind].is_of_light:
                    self.metadata["optics"] = file.metadata.get("optics", "")
                of = "a file that was given" if state == "given" else "the previous calibration"
                return Outcome(state, f"that of {of}, made {file.metadata.get('created_utc', 'at an unknown time')}")
        return None


def material_of(file: CalibrationFile | None) -> Material | None:
    """The pad's numbers, as a held touch shows them, that a calibration was made with; None where the board's."""
    text = "board" if file is None else file.metadata.get("operator.material", "board")
    if file is None or text == "board":
        return None
    modulus_pa, poisson, thickness_m = (float(v) for v in text.split(","))
    return Material(modulus_pa * left_after(file.tensors, HELD_S), poisson, thickness_m)


def stiffness_sigma_of(file: CalibrationFile | None) -> float | None:
    """Relative standard deviation of the force that `material_of` leaves; None where the file does not state it."""
    text = None if file is None else file.metadata.get("support.stiffness_sigma_1e6")
    return None if text is None else int(text) * 1e-6
