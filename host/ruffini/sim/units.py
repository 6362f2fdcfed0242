"""Which simulated body a board has."""

from __future__ import annotations

from ruffini.boards import Board
from ruffini.sim.bodies.dome_unit import DomeUnit
from ruffini.sim.bodies.platform import Platform
from ruffini.sim.bodies.platform_unit import PlatformUnit
from ruffini.sim.bodies.skin_unit import SkinUnit
from ruffini.sim.rig import Unit
from ruffini.sim.settings import TwinSettings, load_twin
from ruffini.sim.unit import PadError, Progress, TwinUnit


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
    return PlatformUnit(board, twin, unit.model, unit.compliance, platform=Platform.of(twin.platform))
