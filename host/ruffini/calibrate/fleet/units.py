"""Many units fitted alike: each its own pad, then what they have in common, who stands out, and a prior for new ones.

What a fit costs is what the finite elements of a grid of pads cost, which all units share: units are fitted in groups,
each group on one worker.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from ruffini import workers
from ruffini.boards import Board, parse_board
from ruffini.calibrate import container
from ruffini.calibrate.log.touches import TouchLog, read_touch_log
from ruffini.errors import InputError, RuffiniError
from ruffini.estimators.material.fit import MIN_TOUCHES, MaterialFit, MaterialProblem, log_of_touches
from ruffini.estimators.material.judge import touch_figures
from ruffini.estimators.material.model import MaterialLog, Predictor
from ruffini.estimators.material.prior import LEAST_SPREAD, Prior, fleet_prior, has_finite_strain
from ruffini.estimators.material.stage import SIGMA_M, TILT_M
from ruffini.estimators.operator.fit import Material
from ruffini.estimators.operator.gauge import gauge_uncertainty_m
from ruffini.fem.operators import Noise
from ruffini.files import readable

Array = npt.NDArray[np.float64]
Progress = Callable[[float], None]

FRAMES_A_TOUCH = 3  # they err together: more cost time and tell little
LARGEST_GROUP = 16  # units: their frames are in memory together
DASK_GROUP = 4  # units, on a cluster of unknown size
OUTLIER = 3.5  # robust standard deviations (median, MAD) from a large fleet: one unit of 2,000 by chance
FEW_UNITS = 4.0  # of so many units the MAD is off by its own size: OUTLIER is doubled
LEAST_ERROR_SPREAD = 0.002  # of the largest force: units alike within that are alike
MAD_TO_SIGMA = 1.4826


class Unit(NamedTuple):
    """One unit: its log, and what was found of it, or why nothing was."""

    name: str
    material: Material | None
    interval: tuple[float, ...]
    touches: int
    before_n: float  # RMS force error with the board's numbers
    after_n: float  # of touches left out, with its own
    before_gain: float  # size of the forces over the true one, likewise
    after_gain: float
    largest_n: float
    error: str = ""


@dataclass(frozen=True)
class Fleet:
    """Units in the order of their logs; numbers of those that stand out; the prior, None where too few."""

    units: list[Unit]
    outliers: dict[int, str]
    prior: Prior | None
    seconds: float

    def report(self) -> dict[str, Any]:
        """What `ruffini cal fleet --json` prints."""
        good = [u for u in self.units if u.material is not None]
        values = np.array([u.material for u in good]) if good else np.zeros((0, 3))
        spread = (values.std(axis=0, ddof=1) / values.mean(axis=0)).tolist() if len(good) > 1 else None
        return {
            "units": [{**u._asdict(), "material": None if u.material is None else u.material._asdict()}
                      for u in self.units],
            "fitted": len(good), "spread": spread,
            "outliers": {self.units[i].name: why for i, why in self.outliers.items()},
            "before_rmse_n": _rms([u.before_n for u in good]), "after_rmse_n": _rms([u.after_n for u in good]),
            "before_worst_n": max((u.before_n for u in good), default=None),
            "after_worst_n": max((u.after_n for u in good), default=None),
            "prior": None if self.prior is None else self.prior.report(), "seconds": self.seconds,
        }  # fmt: skip


def _rms(values: Sequence[float]) -> float | None:
    return float(np.sqrt(np.mean(np.square(values)))) if values else None


def fit_fleet(
    paths: list[Path], board: Board, colours: Path | None, *, is_finite: bool = False, n_workers: int = 1,
    dask: str | None = None, progress: Progress = lambda _: None,
) -> Fleet:  # fmt: skip
    """Fit every unit; a log that cannot be fitted is named and does not stop the others.

    is_finite: at finite strain, as the units' operators are to be.

    Raises
    ------
    InputError
        Two logs of one name, or no unit that can be fitted.
    """
    start, is_finite = time.monotonic(), has_finite_strain(board, is_asked=is_finite)
    twice = {p.name for p in paths if sum(q.name == p.name for q in paths) > 1}
    if twice:
        raise InputError(f"several logs are called {min(twice)}: units are told apart by their logs' names")
    n_groups = n_workers if dask is None else -(-len(paths) // DASK_GROUP)
    groups = _groups([str(p.resolve()) for p in paths], n_groups)
    given = None if colours is None else readable(colours).read_bytes()
    work = workers.Work(
        fit_group, (board.text, board.name, given, is_finite, groups), f"ruffini-fleet-{time.time_ns()}", "group"
    )
    found: dict[int, list[Unit]] = {}
    for number, units in _each(work, len(groups), n_workers, dask):
        found[number] = units
        progress(len(found) / len(groups))
    units = [u for number in sorted(found) for u in found[number]]
    materials = [u.material for u in units if u.material is not None]
    if not materials:
        raise InputError(f"no unit could be fitted; the first: {units[0].error}")
    outliers = outliers_of(units)
    alike = [u.material for i, u in enumerate(units) if u.material is not None and i not in outliers]
    try:
        prior = fleet_prior(alike, is_finite=is_finite)
    except InputError:
        prior = None
    return Fleet(units, outliers, prior, time.monotonic() - start)


def _each(work: workers.Work, n: int, n_workers: int, dask: str | None) -> Iterator[tuple[int, list[Unit]]]:
    yield from workers.each(work, range(n), n_workers=n_workers, dask=dask)


def _groups(paths: list[str], n_groups: int) -> list[list[str]]:
    """As many groups as wanted, or more where they would become too large."""
    n = max(min(n_groups, len(paths)), -(-len(paths) // LARGEST_GROUP))
    return [list(part) for part in np.array_split(np.array(paths, dtype=object), n)]


def fit_group(
    text: str, name: str, colours: bytes | None, is_finite: bool, groups: list[list[str]], number: int
) -> list[Unit]:
    """Fit the units of one group; on a worker."""
    board = parse_board(text, name)
    calibration = None if colours is None else container.unpack(colours)
    logs: list[MaterialLog | str] = []
    for path in groups[number]:
        try:
            read = read_touch_log([Path(path)], board, calibration)
            logs.append(unit_log(read))
        except RuffiniError as error:
            logs.append(str(error))
    good = [log for log in logs if not isinstance(log, str)]
    parts = iter(predictors(board, good, is_finite=is_finite) if good else [])
    units = []
    for path, log in zip(groups[number], logs, strict=True):
        if isinstance(log, str):
            units.append(_unfitted(path, log))
            continue
        try:
            with threadpool_limits(limits=1):
                units.append(_unit(path, MaterialProblem(board, log, next(parts)).fit()))
        except InputError as error:
            units.append(_unfitted(path, str(error)))
    return units


def unit_log(read: TouchLog) -> MaterialLog:
    """The frames of a unit that are fitted."""
    return log_of_touches(read.displacement, read.wrench, read.touch, MIN_TOUCHES, at_most_frames=FRAMES_A_TOUCH)


def predictors(board: Board, logs: list[MaterialLog], *, is_finite: bool = False) -> list[Predictor]:
    """One for each log; the finite elements are solved once for all."""
    noise = Noise(SIGMA_M, gauge_m=gauge_uncertainty_m(board), tilt_m=TILT_M)
    with threadpool_limits(limits=1):
        together = np.concatenate([log.displacement for log in logs])
        whole = Predictor(board, together, noise, lambda _: None, is_finite=is_finite)
    ends = np.cumsum([len(log.displacement) for log in logs])
    return [whole.part(slice(int(end) - len(log.displacement), int(end))) for log, end in zip(logs, ends, strict=True)]


def _unfitted(path: str, why: str) -> Unit:
    return Unit(Path(path).name, None, (), 0, 0.0, 0.0, 0.0, 0.0, 0.0, why)


def _unit(path: str, fit: MaterialFit) -> Unit:
    before, after = (touch_figures(fit, wrench) for wrench in (fit.before, fit.left_out))
    return Unit(
        Path(path).name, fit.material, tuple(fit.interval.tolist()), fit.n_touches, before["force_rmse_n"],
        after["force_rmse_n"], before["gain"], after["gain"], after["largest_force_n"],
    )  # fmt: skip


def outliers_of(units: list[Unit]) -> dict[int, str]:
    """Numbers of the units that stand out among the fitted ones, and by what."""
    fitted = [i for i, u in enumerate(units) if u.material is not None]
    materials = [u.material for u in units if u.material is not None]
    columns = {
        "E": [m.modulus_pa for m in materials], "Poisson's ratio": [m.poisson for m in materials],
        "thickness": [m.thickness_m for m in materials],
        "error": [u.after_n / u.largest_n for u in units if u.material is not None],
    }  # fmt: skip
    limit = OUTLIER * (1 + FEW_UNITS / len(fitted))
    found: dict[int, str] = {}
    for (name, values), relative in zip(columns.items(), (*LEAST_SPREAD, None), strict=True):
        middle = float(np.median(values))
        least = LEAST_ERROR_SPREAD if relative is None else relative * middle
        sigma = max(MAD_TO_SIGMA * float(np.median(np.abs(np.array(values) - middle))), least)
        for i, value in zip(fitted, values, strict=True):
            if abs(value - middle) > limit * sigma and (name != "error" or value > middle):
                said = f"{name} {abs(value - middle) / sigma:.1f} sigma off"
                found[i] = f"{found[i]}, {said}" if i in found else said
    return found
