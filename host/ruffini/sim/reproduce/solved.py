"""The mechanics of a run, kept between runs of the program: pictures can be made again without solving again.

`$XDG_CACHE_HOME/ruffini/twin/runs/<hash>.npz`; only time depends on it, as with `ruffini.sim.cache`.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ruffini import sim
from ruffini.errors import InputError
from ruffini.files import write_whole
from ruffini.sim.bodies.platform_unit import PlatformUnit
from ruffini.sim.cache import cache_folder
from ruffini.sim.optics.conditions import TrayPose
from ruffini.sim.programs import n_frames_of
from ruffini.sim.reproduce.runs import Run
from ruffini.sim.reproduce.settings import AgingSettings, PressSet
from ruffini.sim.rig import Unit
from ruffini.sim.story import Moment, play
from ruffini.sim.surface import hat_areas, hat_shares
from ruffini.sim.unit import TwinUnit

Array = npt.NDArray[np.float64]

# What only the picture depends on: the mechanics stays.
OPTICS = ("light", "noise", "lens", "gel", "view", "dots", "glitter", "pins", "targets", "sensor", "wear", "warming")
FULL_AGE = 10_000  # presses that the numbers of [aging] are for


@dataclass(frozen=True)
class KeptMoment:
    """One frame's truth with the face of `story.Moment`, and two numbers of the contact besides.

    area_m2 : where a flat pad is touched; gel_depth_m : its mean displacement there, into the pad. NaN of other bodies.
    """

    arrays: dict[str, Array]
    frame: int

    def _at(self, name: str) -> Array:
        return np.asarray(self.arrays[name][self.frame])

    @property
    def displacement(self) -> Array:
        return self._at("displacement").astype(float)

    @property
    def tray(self) -> TrayPose | None:
        shift, turn = self._at("tray")[:3].tolist(), self._at("tray")[3:].tolist()
        return None if np.isnan(shift[0]) else TrayPose((shift[0], shift[1], shift[2]), (turn[0], turn[1], turn[2]))

    @property
    def touch(self) -> int:
        return int(self._at("touch"))

    @property
    def judged(self) -> bool:
        return bool(self._at("judged"))

    @property
    def area_m2(self) -> float:
        return float(self._at("area_m2"))

    @property
    def gel_depth_m(self) -> float:
        return float(self._at("gel_depth_m"))

    def wrench(self) -> Array:
        return self._at("wrench")

    def pose_row(self) -> Array:
        return self._at("pose")

    def nodal_state(self) -> npt.NDArray[np.uint8]:
        return self._at("contact").astype(np.uint8)

    def nodal_force(self) -> Array:
        return self._at("force")

    def nodal_displacement(self) -> Array:
        return self._at("nodes").astype(float)


def aged(unit: Unit, aging: AgingSettings, n_pressed: int) -> Unit:
    """The unit after so many presses: softer, and darker.

    Raises
    ------
    InputError
        It is no flat pad, or nothing is left of it.
    """
    if not n_pressed:
        return unit
    if not isinstance(unit, TwinUnit):
        raise InputError(f"board {unit.board.name!r} does not age: only flat pads do, leave `after` out")
    part = n_pressed / FULL_AGE
    modulus = 1 - part * aging.modulus_loss_1e3 * 1e-3
    light = 1 - part * aging.light_loss_1e3 * 1e-3
    if modulus <= 0 or light <= 0:
        raise InputError(f"[aging] leaves nothing of the unit after {n_pressed} presses: give it smaller losses")
    level = max(10, round(unit.twin.light.mean_level * light))
    twin = unit.twin.model_copy(update={"light": unit.twin.light.model_copy(update={"mean_level": level})})
    model = replace(unit.model, modulus_pa=unit.model.modulus_pa * modulus)
    return replace(unit, twin=twin, model=model, compliance=unit.compliance / modulus)


def slowed(unit: Unit, run: Run) -> Unit:
    """The unit with a camera that takes no more frames than the run wants."""
    every = run.frame_every(unit.board.camera.rate_mhz * 1e-3)
    if every == 1:
        return unit
    camera = unit.board.camera.model_copy(update={"rate_mhz": round(unit.board.camera.rate_mhz / every)})
    return replace(unit, board=unit.board.model_copy(update={"camera": camera}))  # type: ignore[type-var]


def solved(unit: Unit, run: Run) -> list[KeptMoment]:
    """Every frame of a run, from the cache where it is there.

    Raises
    ------
    InputError, RuffiniError
        An indenter leaves the pad or presses too deep, or no equilibrium was found.
    """
    path = cache_folder() / "runs" / f"{_key(unit, run)}.npz"
    story = run.story(unit.board)
    total = n_frames_of(story)
    arrays = _kept(path, total)
    if arrays is None:
        arrays = _solve(unit, run)
        stream = io.BytesIO()
        np.savez(stream, allow_pickle=False, **arrays)
        with contextlib.suppress(InputError):  # a cache that cannot be written is no error
            write_whole(path, stream.getvalue(), is_durable=False)
    return [KeptMoment(arrays, i) for i in range(total)]


def _key(unit: Unit, run: Run) -> str:
    mechanics = unit.twin.model_dump(exclude=set(OPTICS))
    told = [
        unit.body_toml(), mechanics, _friction(unit, run), run.story(unit.board), unit.board.pad, unit.board.grid,
        unit.board.camera.rate_mhz,
    ]  # fmt: skip
    if isinstance(unit, PlatformUnit):
        told += [unit.platform.springs.tolist(), unit.platform.sleeve.tolist()]  # other ones where it is warmer
    return hashlib.sha256(repr(told).encode() + _code()).hexdigest()[:32]


@lru_cache(maxsize=1)
def _code() -> bytes:
    """Of everything that solves: another solver is another result."""
    folder = Path(sim.__file__).parent
    files = sorted(p for part in (".", "bodies", "indenters") for p in (folder / part).glob("*.py"))
    return hashlib.sha256(np.__version__.encode() + b"".join(p.read_bytes() for p in files)).digest()


def _friction(unit: Unit, run: Run) -> int:
    own = run.settings.friction_1e3 if isinstance(run.settings, PressSet) else None
    return unit.twin.unit.friction_1e3 if own is None else own


def _kept(path: Path, n_frames: int) -> dict[str, Array] | None:
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: np.asarray(file[name]) for name in file.files}
        return arrays if len(arrays["displacement"]) == n_frames else None
    except (OSError, ValueError, KeyError, EOFError):
        return None  # not there, or not whole
    except Exception as error:  # zipfile has errors of its own
        if type(error).__name__ == "BadZipFile":
            return None
        raise


def _solve(unit: Unit, run: Run) -> dict[str, Array]:
    slippery = unit.twin.unit.model_copy(update={"friction_1e3": _friction(unit, run)})
    unit = replace(unit, twin=unit.twin.model_copy(update={"unit": slippery}))  # type: ignore[type-var]
    rows = [_row(unit, moment) for moment in play(unit, run.story(unit.board))]
    return {name: np.stack([np.asarray(row[name]) for row in rows]) for name in rows[0]}


def _row(unit: Unit, moment: Moment) -> dict[str, npt.ArrayLike]:
    tray, solver = moment.tray, moment.solver
    area = sunk = np.nan
    if solver is not None:
        areas, touched = hat_areas(solver.model), solver.hat_force[:, 2] < 0
        area = float(areas[touched].sum())
        sunk = -float((areas * (hat_shares(solver.model).T @ solver.displacement[:, 2]))[touched].sum()) / max(
            area, 1e-12
        )
    return {
        "displacement": moment.displacement.astype(np.float32), "nodes": moment.nodal_displacement().astype(np.float32),
        "wrench": moment.wrench(), "force": moment.nodal_force(), "contact": moment.nodal_state(),
        "pose": moment.pose_row(), "touch": moment.touch, "judged": moment.judged, "area_m2": area,
        "gel_depth_m": sunk, "tray": np.full(6, np.nan) if tray is None else (*tray.shift_m, *tray.turn_rad),
    }  # fmt: skip
