"""Which simulated body a board has."""

from __future__ import annotations

import numpy as np

from ruffini.boards import Board
from ruffini.sim.bodies.dome_unit import DomeUnit
from ruffini.sim.bodies.platform import Platform
from ruffini.sim.bodies.platform_unit import PlatformUnit
from ruffini.sim.bodies.skin_unit import SkinUnit
from ruffini.sim.rig import Unit
from ruffini.sim.settings import TwinSettings, load_twin
from ruffini.sim.unit import PadError, Progress, TwinUnit

# Standard deviation of what moulds and mixes vary, as parts.
FLEET_SPREAD = {"modulus": 0.10, "thickness": 0.04, "poisson": 0.004}


def build_unit(
    board: Board,
    error: PadError | None = None,
    *,
    twin: TwinSettings | None = None,
    progress: Progress = lambda _: None,
) -> Unit:
    """The simulated sensor of a board; `twin` instead of the board's own.

    Raises
    ------
    InputError
        The board has no twin, or the factors make a body that cannot be.
    """
    twin = twin or load_twin(board)
    if twin.shape.kind == "dome":
        return DomeUnit.build(board, error or PadError(), twin)
    if twin.shape.kind == "tube":
        return SkinUnit.build(board, error or PadError(), twin)
    unit = TwinUnit.build(board, error, twin=twin, progress=progress)
    if twin.platform is None:
        return unit
    rubber = 1.0 if error is None else error.modulus  # pad and sleeve are cast of one mix; springs are bought
    platform = Platform.of(twin.platform, rubber=rubber)
    return PlatformUnit(board, twin, unit.model, unit.compliance, platform=platform)


def fleet_error(board: Board, number: int) -> PadError:
    """How unit `number` of a simulated fleet is off its board file: always the same; 0: not at all."""
    if number == 0:
        return PadError()
    rng = np.random.default_rng([number, 20])
    modulus, thickness, poisson = (np.exp(s * np.clip(rng.standard_normal(), -2.5, 2.5)) for s in FLEET_SPREAD.values())
    is_flat = load_twin(board).shape.kind == "plane"  # other bodies are taken as incompressible
    return PadError(float(modulus), float(poisson) if is_flat else 1.0, float(thickness))
