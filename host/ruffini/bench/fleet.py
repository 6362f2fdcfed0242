"""A fleet of simulated units: how far apart they measure before and after `cal fleet`, and how long that takes.

Each unit's pad is off its board file (`sim.units.fleet_error`), and so is its press program. Units are recorded once
into the folder that is given and kept there. Their colours are one table: the same lamps before each pad.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ruffini.bench.fitted import colours_of
from ruffini.boards import Board, parse_board
from ruffini.calibrate import container
from ruffini.calibrate.fleet.units import Fleet, fit_fleet, predictors, unit_log
from ruffini.calibrate.log.touches import read_touch_log
from ruffini.estimators.material.fit import MaterialProblem
from ruffini.estimators.material.model import MaterialLog, Predictor
from ruffini.estimators.material.prior import board_prior, fleet_prior
from ruffini.estimators.operator.report import touch_errors
from ruffini.sim.programs import grid
from ruffini.sim.recording import record_touches
from ruffini.sim.units import build_unit, fleet_error

Progress = Callable[[float], None]

PRESSES = (1, 2, 3, 5)  # of a new unit, with the other units' prior and without
N_TOUCHES, SEED, N_DRAWS = 12, 500, 4
WORKERS = (1, 2)
REPORTED = ("fitted", "before_rmse_n", "after_rmse_n", "before_worst_n", "after_worst_n", "spread", "outliers")


def record_fleet(board: Board, folder: Path, n_units: int, *, progress: Progress = lambda _: None) -> list[Path]:
    """Recordings of units 1 to n; those that are there are kept."""
    paths = [folder / f"unit{i:03d}" for i in range(1, n_units + 1)]
    for i, path in enumerate(paths):
        if not (path / "recording.toml").is_file():  # written last: what lacks it was stopped
            shutil.rmtree(path, ignore_errors=True)
            unit, seed = build_unit(board, fleet_error(board, i + 1)), SEED + i + 1
            record_touches(unit, grid(board, N_TOUCHES, np.random.default_rng(seed)), path, seed=seed, program="grid")
        progress((i + 1) / n_units)
    return paths


def run(
    board: Board, folder: Path, n_units: int, *, modulus: float = 1.0, progress: Progress = lambda _: None
) -> dict[str, Any]:
    """Record, fit with one worker and with two, and adapt each unit with a prior of the others.

    modulus : factor on the board's own for the fits, as where a datasheet is wrong; the recordings stay.
    """
    paths = record_fleet(board, folder, n_units, progress=lambda done: progress(0.5 * done))
    colours = folder / "colours.safetensors"
    if not colours.is_file():
        container.write(colours, container.pack(colours_of(board), container.base_metadata(board)))
    mean, truth = board_prior(board).mean, [fleet_error(board, i + 1) for i in range(n_units)]
    board = with_modulus(board, modulus)
    seconds, fleet = {}, None
    for n_workers in WORKERS:
        fleet = fit_fleet(paths, board, colours, n_workers=n_workers)
        seconds[n_workers] = fleet.seconds
        progress(0.5 + 0.15 * n_workers)
    assert fleet is not None
    presses = adapted(board, fleet, paths, container.read(colours))
    progress(1.0)
    off = np.array([
        np.array(u.material) / (mean * (t.modulus, t.poisson, t.thickness)) - 1
        for u, t in zip(fleet.units, truth, strict=True) if u.material is not None
    ])  # fmt: skip
    report = fleet.report()
    return {
        "board": board.name, "modulus": modulus, "units": n_units, "touches": N_TOUCHES, "simulated": True,
        "seconds": seconds,
        "largest_n": max(u.largest_n for u in fleet.units), "presses": presses,
        "material_off_rms": np.sqrt(np.mean(off**2, axis=0)).tolist(),
        **{k: report[k] for k in REPORTED}, "gain_spread": _gain_spread(fleet),
    }  # fmt: skip


def with_modulus(board: Board, factor: float) -> Board:
    """A board whose file says another modulus."""
    told = f"modulus_pa = {board.pad.modulus_pa}"
    return parse_board(board.text.replace(told, f"modulus_pa = {round(board.pad.modulus_pa * factor)}"), board.name)


def _gain_spread(fleet: Fleet) -> dict[str, float]:
    """Standard deviation between units of the size of the force they state over the true one."""
    good = [u for u in fleet.units if u.material is not None]
    return {name: float(np.std([getattr(u, f"{name}_gain") for u in good], ddof=1)) for name in ("before", "after")}


def adapted(
    board: Board, fleet: Fleet, paths: list[Path], colours: container.CalibrationFile
) -> list[dict[str, float]]:
    """RMS force error (N) of the other touches of a unit when few are fitted: from the board's numbers, and from the
    fleet's without this unit."""
    units = [u for u in fleet.units if u.material is not None]
    names = {u.name for u in units}
    logs = []
    for path in paths:
        if path.name in names:
            logs.append(unit_log(read_touch_log([path], board, colours)))
    rng = np.random.default_rng(SEED)
    error: dict[int, dict[str, list[float]]] = {n: {"board": [], "fleet": []} for n in (0, *PRESSES)}
    for i, (log, predictor) in enumerate(zip(logs, predictors(board, logs), strict=True)):
        others = [u.material for j, u in enumerate(units) if j != i and u.material is not None]
        priors = {"board": board_prior(board), "fleet": fleet_prior(others)}
        touches = np.unique(log.touch)
        for name, prior in priors.items():
            error[0][name] += _squares(log, predictor, prior.mean, touches)
        for n in PRESSES:
            for order in [rng.permutation(touches) for _ in range(N_DRAWS)]:
                for name, prior in priors.items():
                    values = MaterialProblem(board, log, predictor, prior).solve(np.isin(log.touch, order[:n]))
                    error[n][name] += _squares(log, predictor, values, order[n:])
    return [{"presses": n, **{k: float(np.sqrt(np.mean(v))) for k, v in e.items()}} for n, e in error.items()]


def _squares(log: MaterialLog, predictor: Predictor, values: Any, touches: Any) -> list[float]:
    return [float(e) ** 2 for e in touch_errors(log, predictor.wrench(values), touches)]


def table(result: dict[str, Any]) -> str:
    """What a person reads."""
    lines = [
        f"{result['board']}, SIMULATED: {result['fitted']} of {result['units']} units fitted, {result['touches']} "
        f"touches each, forces up to {result['largest_n']:.1f} N",
        "                                  board's numbers   its own",
        f"force error, RMS, mN              {1e3 * result['before_rmse_n']:15.1f} {1e3 * result['after_rmse_n']:9.1f}",
        f"worst unit, mN                    {1e3 * result['before_worst_n']:15.1f} "
        f"{1e3 * result['after_worst_n']:9.1f}",
        f"spread of the units' gain, %      {100 * result['gain_spread']['before']:15.2f} "
        f"{100 * result['gain_spread']['after']:9.2f}",
        "presses   from the board's numbers   from the other units, force error of the other touches, mN",
    ]
    lines += [f"{r['presses']:7d} {1e3 * r['board']:26.1f} {1e3 * r['fleet']:22.1f}" for r in result["presses"]]
    off = ", ".join(f"{100 * v:.1f} %" for v in result["material_off_rms"])
    lines.append(f"E, Poisson's ratio, thickness are off by {off} RMS")
    lines += [f"{n} worker{'s' if n > 1 else ''}: {s:.0f} s" for n, s in result["seconds"].items()]
    return "\n".join(lines)
