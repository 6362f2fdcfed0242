"""What is believed of a pad before it is pressed: E, Poisson's ratio and thickness, and how far a unit may be off.

Three sources: the board's numbers (a datasheet and a caliper), the previous calibration of the same unit (another gel
of the same mould), or a fleet of units that were measured. The last is fitted by `ruffini cal fleet` and kept as JSON.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate.container import CalibrationFile
from ruffini.calibrate.log.reference import read_fit
from ruffini.errors import InputError
from ruffini.estimators.operator.fit import Material, board_slab
from ruffini.files import write_whole

Array = npt.NDArray[np.float64]

# Standard deviations, relative, of E, nu, h. Of the board's numbers: what a datasheet and a caliper know.
OF_BOARD = (0.3, 0.03, 0.05)
# Of another gel from the same mould: the casting of silicone by the same hand; an assumption of ours until a fleet
# replaces it.
OF_NEXT_GEL = (0.10, 0.01, 0.03)
MIN_FLEET = 4  # units whose spread says something
LEAST_SPREAD = (0.01, 0.001, 0.003)  # a fleet is not believed to be more alike than that


@dataclass(frozen=True)
class Prior:
    """`mean` (E Pa, nu, h m) and the covariance (3, 3) of what a unit is off, relative to the mean.

    `is_finite`: whether those pads were fitted at finite strain; None: they were not fitted.
    """

    source: str
    mean: Array
    covariance: Array
    is_finite: bool | None = None

    @property
    def is_informed(self) -> bool:
        """Whether pads were measured for it: then a few presses are enough."""
        return self.source != "board"

    def deviation(self, values: Array) -> Array:
        """How far values are from the mean, in standard deviations, (3,) uncorrelated."""
        return np.linalg.solve(np.linalg.cholesky(self.covariance), values / self.mean - 1)

    def report(self) -> dict[str, Any]:
        """For the report of a fit."""
        spread = np.sqrt(np.diag(self.covariance))
        return {
            "source": self.source, "mean": dict(zip(Material._fields, self.mean.tolist(), strict=True)),
            "relative_sigma": dict(zip(Material._fields, spread.tolist(), strict=True)),
        }  # fmt: skip


def has_finite_strain(board: Board, *, is_asked: bool) -> bool:
    """Whether a board's pad is fitted and solved at finite strain, which its second pass adds."""
    return is_asked and "support" in board.pipeline.stages


def is_of_finite_strain(file: CalibrationFile) -> bool:
    """Whether a calibration's pad was fitted and is solved at finite strain."""
    return "finite_strain" in file.kinds


def strain_name(is_finite: bool) -> str:
    """As `--strain` has it."""
    return "finite" if is_finite else "linear"


def read_strain(tree: dict[str, Any]) -> bool:
    """Whether a written fit is of finite strain; those of before it was written are of linear strain.

    Raises
    ------
    ValueError
        Another word than `strain_name` has.
    """
    word = tree.get("strain", "linear")
    if word not in ("linear", "finite"):
        raise ValueError(f"strain {word!r} is neither linear nor finite")
    return bool(word == "finite")


def strain_remark(what: str, *, fitted: bool | None, used: bool) -> str | None:
    """A sentence where numbers were fitted at another strain (True: finite) than they are used at."""
    if fitted is None or fitted == used:
        return None
    remedy = "give --strain finite here, too" if fitted else "fit it again with --strain finite"
    return (
        f"{what} was fitted at {strain_name(fitted)} strain and is used at {strain_name(used)}: forces of presses "
        f"deeper than a tenth of the pad's thickness are then several percent off; {remedy}"
    )


def board_prior(board: Board) -> Prior:
    """The board's own numbers."""
    slab = board_slab(board)
    return Prior("board", np.array([slab.modulus_pa, slab.poisson, slab.thickness_m]), np.diag(np.square(OF_BOARD)))


def next_gel_prior(material: Material, *, is_finite: bool = False) -> Prior:
    """Another gel on the unit whose last one was `material`."""
    return Prior("previous", np.array(material), np.diag(np.square(OF_NEXT_GEL)), is_finite)


def fleet_prior(materials: list[Material], *, is_finite: bool = False) -> Prior:
    """Mean and spread of units that were measured.

    Raises
    ------
    InputError
        Too few units to know their spread.
    """
    if len(materials) < MIN_FLEET:
        raise InputError(f"{len(materials)} units tell no spread: fit {MIN_FLEET} at least")
    values = np.array(materials)
    mean = values.mean(axis=0)
    relative = values / mean - 1
    # A unit that comes is off the mean of n by more than the units were among themselves.
    covariance = np.cov(relative.T) * (1 + 1 / len(values)) + np.diag(np.square(LEAST_SPREAD))
    return Prior(f"fleet of {len(values)}", mean, covariance, is_finite)


def write_prior(path: Path, board: Board, prior: Prior) -> None:
    """A prior as JSON, whole or not at all."""
    tree = {
        "board": board.name, "source": prior.source, "mean": prior.mean.tolist(),
        "relative_covariance": prior.covariance.tolist(),
    }  # fmt: skip
    if prior.is_finite is not None:
        tree["strain"] = strain_name(prior.is_finite)
    write_whole(path, json.dumps(tree, indent=1).encode() + b"\n")


def read_prior(path: Path, board: Board) -> Prior:
    """What `write_prior` wrote.

    Raises
    ------
    InputError
        Unreadable, no prior, or of another board.
    """

    def parse(tree: dict[str, Any]) -> Prior:
        mean, covariance = np.array(tree["mean"], float), np.array(tree["relative_covariance"], float)
        if mean.shape != (3,) or covariance.shape != (3, 3) or not (mean > 0).all():
            raise ValueError("it needs three positive means and a 3 x 3 covariance")
        try:
            np.linalg.cholesky(covariance)
        except np.linalg.LinAlgError:
            raise ValueError("its covariance is not positive definite") from None
        return Prior(str(tree["source"]), mean, covariance, read_strain(tree))

    return read_fit(path, board, "cal fleet", parse)
