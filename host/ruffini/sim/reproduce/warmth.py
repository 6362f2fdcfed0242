"""A unit on a tray that got warmer since its rest was learned: other springs, another sleeve, and a tray that rose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError
from ruffini.sim.bodies.platform_unit import PlatformUnit
from ruffini.sim.reproduce.runs import Run
from ruffini.sim.reproduce.settings import HandSet, WarmthSettings
from ruffini.sim.reproduce.solved import KeptMoment
from ruffini.sim.rig import Unit

AT_REST_C = 23.0


def warmer_k(run: Run) -> float:
    """By how much the unit of a run is warmer than when its rest was learned."""
    s = run.settings
    if not isinstance(s, HandSet) or not s.warmer_mk:
        return 0.0
    return 1e-3 * s.warmer_mk[(int(str(run.chosen["take"])) - 1) % len(s.warmer_mk)]


def warmed(unit: Unit, warmth: WarmthSettings, kelvin: float) -> Unit:
    """The unit with stiffness as it is then.

    Raises
    ------
    InputError
        It stands on no tray.
    """
    if not kelvin:
        return unit
    if not isinstance(unit, PlatformUnit):
        raise InputError(f"board {unit.board.name!r} has no tray: leave warmer_mk out")
    cold = unit.platform
    springs = cold.springs * (1 + 1e-6 * warmth.springs_1e6 * kelvin)
    sleeve = cold.sleeve * (1 + 1e-6 * warmth.sleeve_1e6 * kelvin)
    return replace(unit, platform=replace(cold, springs=springs, sleeve=sleeve))


def risen(moments: list[KeptMoment], warmth: WarmthSettings, kelvin: float, n_rest: int) -> list[KeptMoment]:
    """With the tray higher in every frame but the `n_rest` from which rest is learned."""
    if not kelvin:
        return moments
    tray = np.array(moments[0].arrays["tray"])
    tray[n_rest:, 2] += 1e-9 * warmth.rise_nm * kelvin
    arrays = {**moments[0].arrays, "tray": tray}
    return [KeptMoment(arrays, m.frame) for m in moments]


def celsius_read(run: Run, warmth: WarmthSettings, n_frames: int, n_rest: int) -> npt.NDArray[np.float64]:
    """What the board's thermometer says in every frame."""
    celsius = np.full(n_frames, AT_REST_C)
    celsius[n_rest:] += warmer_k(run)
    noise = np.random.default_rng([run.seed, 6]).normal(size=n_frames)
    return np.asarray(celsius + 1e-3 * warmth.thermometer_noise_mk * noise)
