"""A MuJoCo world whose fingers carry a board's pads."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from ruffini.api.frame import SensorFrame
from ruffini.boards import Board, find_board
from ruffini.errors import InputError
from ruffini.robot.attached import AttachedPad, Frame
from ruffini.robot.checks import check
from ruffini.robot.core_sensor import CoreSensor, default_calibration
from ruffini.robot.mechanics import PadSolid
from ruffini.sim.pad import BLAS

Array = npt.NDArray[np.float64]

NO_NOISE = (0.0, 0.0, 0.0)


class World:
    """Physics and pads, step by step; the frames are those of the pads' cameras, at the board's rate.

    Parameters
    ----------
    model : an MJCF file or its text, or a mujoco.MjModel. The integrator must not be RK4.
    pads : name of each pad's site, or geom of type box, and its board's name. The site's z, or the box's, is out of the
        pad, whose centre is the site's, or the middle of the box's upper face. A box that is a pad does not collide.
    stiffness : of the pads, over the board's.
    noise_m : standard deviation of the displacement along x, y, z.
    calibrations : of boards, by name; where left out, the default operator's.
    moduli_pa : Young's modulus of geoms, by name, that are soft; others are rigid.
    is_feeling : False: no core runs, and frames are read elsewhere (`ruffini.robot.live`).

    Attributes
    ----------
    model, data : MuJoCo's own; write `data.ctrl` and move what you like before `start`.
    pads : by name; `wrench` is the true one.

    Notes
    -----
    The pad's forces act as applied forces, equal and opposite on finger and object, and not as MuJoCo's soft contact:
    that one's stiffness follows the bodies' masses, and its friction creeps. They are in `data.xfrc_applied` within a
    step only: between steps it holds what the program wrote, which acts beside them. Force, moment, area and stick and
    slip are the pad's own, and the frames are of exactly the forces that act.
    """

    def __init__(
        self, model: Any, pads: Mapping[str, str | Board], *, stiffness: float = 1.0,
        noise_m: tuple[float, float, float] = NO_NOISE, seed: int = 0,
        calibrations: Mapping[str, bytes] | None = None, is_feeling: bool = True,
        moduli_pa: Mapping[str, float] | None = None,
    ) -> None:  # fmt: skip
        _check_settings(pads, stiffness, noise_m)
        self.model = _model_of(model)
        moduli = dict(moduli_pa or {})
        _check_moduli(self.model, moduli)
        self.data = mujoco.MjData(self.model)
        solids: dict[str, PadSolid] = {}
        self.pads: dict[str, AttachedPad] = {}
        boards: dict[str, Board] = {}
        for name, wanted in pads.items():
            board = find_board(wanted) if isinstance(wanted, str) else wanted
            if board.name not in solids:
                solids[board.name] = PadSolid.of_board(board, stiffness=stiffness)
            boards[name] = board
            self.pads[name] = AttachedPad(
                name, solids[board.name], self.model, *_place_of(self.model, name), moduli
            )  # fmt: skip
        rates = {board.camera.rate_mhz for board in boards.values()}
        if len(rates) != 1:
            raise InputError("the pads' cameras must have one rate: use boards of one kind")
        self.frame_s = 1e3 / rates.pop()
        self._sensors: dict[str, CoreSensor] = {}
        if is_feeling:
            made = dict(calibrations or {})
            for board in boards.values():
                if board.name not in made:
                    made[board.name] = default_calibration(board)
            self._sensors = {
                name: CoreSensor(board, name, i, made[board.name], noise_m, seed)
                for i, (name, board) in enumerate(boards.items())
            }
        self._n_frames = 0
        self.is_started = False

    def __enter__(self) -> World:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Free the cores."""
        for sensor in self._sensors.values():
            sensor.close()

    def reset(self, seed: int | None = None) -> None:
        """Back to the model's start; `start` again before the first step."""
        mujoco.mj_resetData(self.model, self.data)
        self._n_frames, self.is_started = 0, False
        for pad in self.pads.values():
            pad.reset()
        for sensor in self._sensors.values():
            sensor.reset(seed)

    def start(self) -> None:
        """Check the world as it stands.

        Raises
        ------
        InputError
            It cannot be simulated; the text says why, and what to do.
        """
        mujoco.mj_forward(self.model, self.data)
        check(self.model, self.data, list(self.pads.values()))
        self.is_started = True

    def advance(self) -> None:
        """One step of the physics."""
        if not self.is_started:
            self.start()
        mujoco.mj_step1(self.model, self.data)
        applied = np.zeros_like(self.data.xfrc_applied)
        for pad in self.pads.values():
            pad.advance(self.data, self.model.opt.timestep, applied)
        of_others = self.data.xfrc_applied.copy()
        self.data.xfrc_applied += applied
        mujoco.mj_step2(self.model, self.data)
        self.data.xfrc_applied[:] = of_others

    def step(self) -> dict[str, SensorFrame]:
        """Physics up to the next frame of the cameras; the frame of each pad, in fast mode."""
        self._n_frames += 1
        with BLAS.limit(limits=1):
            while self.data.time < self._n_frames * self.frame_s - 1e-9:
                self.advance()
        return {
            name: sensor.feel(self.pads[name].contact.board_displacement(), self.data.time)
            for name, sensor in self._sensors.items()
        }


def _check_settings(pads: Mapping[str, str | Board], stiffness: float, noise_m: tuple[float, float, float]) -> None:
    if not pads:
        raise InputError("the world has no pads: give at least one site or box of the model, with its board")
    if not 0 < stiffness < np.inf:
        raise InputError(f"stiffness {stiffness}: give a number above zero, 1 for the board's own")
    if np.shape(noise_m) != (3,) or not all(0 <= one < np.inf for one in noise_m):
        raise InputError(f"noise_m {noise_m}: give three standard deviations in metres, along x, y, z, none below zero")


def _check_moduli(model: Any, moduli_pa: Mapping[str, float]) -> None:
    for name, modulus in moduli_pa.items():
        if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, name) < 0:
            raise InputError(f"the model has no geom {name!r} to be soft: name it in its MJCF")
        if not modulus > 0:
            raise InputError(f"geom {name!r} with a modulus of {modulus} Pa: give a number above zero")


def _model_of(model: Any) -> Any:
    if isinstance(model, mujoco.MjModel):
        return model
    try:
        if isinstance(model, Path) or not str(model).lstrip().startswith("<"):
            return mujoco.MjModel.from_xml_path(str(model))
        return mujoco.MjModel.from_xml_string(model)
    except ValueError as error:
        raise InputError(f"the world is not MJCF that MuJoCo reads: {' '.join(str(error).split())}") from error


def _place_of(model: Any, name: str) -> tuple[int, Frame]:
    """The body of a site or box, and where the pad is in it."""
    kinds = mujoco.mjtObj
    if (site := mujoco.mj_name2id(model, kinds.mjOBJ_SITE, name)) >= 0:
        return int(model.site_bodyid[site]), Frame(_rotation(model.site_quat[site]), model.site_pos[site].copy())
    geom = mujoco.mj_name2id(model, kinds.mjOBJ_GEOM, name)
    if geom < 0:
        raise InputError(f"the model has no site or geom {name!r} to carry a pad: name one in its MJCF")
    if model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_BOX:
        raise InputError(f"geom {name!r} is no box: put a pad on a box, or on a site whose z points out of the pad")
    model.geom_contype[geom] = model.geom_conaffinity[geom] = 0
    rotation = _rotation(model.geom_quat[geom])
    return int(model.geom_bodyid[geom]), Frame(
        rotation, model.geom_pos[geom] + rotation[:, 2] * model.geom_size[geom, 2]
    )


def _rotation(quaternion: Array) -> Array:
    out = np.zeros(9)
    mujoco.mju_quat2Mat(out, quaternion)
    return out.reshape(3, 3)
