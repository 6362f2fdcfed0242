"""A pad's sensor without a picture: displacements through the board's own core, as frames of the public client.

The integers are those of the firmware (`Pipeline.solve`): operator, second pass, wrench, contacts and slip. Validity
and flags follow the firmware's rules: what the board does not measure is NOT_MEASURED here too. Every frame is
SIMULATED; there is no depth and no image.
"""

from __future__ import annotations

import contextlib
import hashlib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

import ruffini
from ruffini.api.frame import SensorFrame
from ruffini.boards import Board
from ruffini.calibrate import container
from ruffini.core.pipeline import DISPLACEMENT_LSB_M, Pipeline
from ruffini.device.results import INVALID, NOT_MEASURED, VALID, Field
from ruffini.errors import InputError
from ruffini.estimators.operator.gauge import USUAL
from ruffini.fem.operators import Noise
from ruffini.files import write_whole
from ruffini.native import native_folder
from ruffini.sim.cache import cache_folder
from ruffini.wire import Schema

Array = npt.NDArray[np.float64]

NOISE_M = USUAL.sigma_m  # of the displacement, as the default operator takes it
UNCALIBRATED_Z, OVER_RANGE = 4, 32  # FlagBit
LARGEST_STEPS = 32767
AXES = ("force_x", "force_y", "force_z", "torque_x", "torque_y", "torque_z")  # as [board] not_measured has them
SLOTS = ("wrench", "contacts", "slip")  # that a frame is made of, beside the nodal forces


def default_calibration(board: Board) -> bytes:
    """A calibration with the board's default operator; made once (a minute), then from the cache.

    Raises
    ------
    InputError
        The board's forces come from no operator.
    """
    from ruffini.estimators.operator.fit import make_operator

    if not board.writes("node_forces"):
        raise InputError(
            f"board {board.name!r} makes its forces from pictures, not from displacements: use another board, or "
            "pictures (is_feeling=False and ruffini.robot.live)"
        )
    settings: dict[str, Any] = {"method": "support", "noise": Noise(NOISE_M)}
    path = cache_folder().parent / "robot" / f"{board.name}-{_key_of(board, settings)}.safetensors"
    if path.is_file():
        return path.read_bytes()
    kind = make_operator(board, **settings)
    data = container.pack(kind.tensors, {**container.base_metadata(board), **kind.metadata}).data
    with contextlib.suppress(InputError):  # a cache that cannot be written costs time only
        write_whole(path, data, is_durable=False)
    return data


def _key_of(board: Board, settings: dict[str, Any]) -> str:
    """Hash of all that a default calibration depends on; it has no seed."""
    found = hashlib.sha256(f"{board.text} {settings} {np.__version__} {scipy.__version__}".encode())
    package = Path(ruffini.__file__).parent
    for path in [*sorted(package.rglob("*.py")), native_folder() / "libruffini.so"]:
        found.update(path.name.encode() + b"\0" + path.read_bytes())
    return found.hexdigest()[:32]


@dataclass(frozen=True, eq=False)
class CoreFrame(SensorFrame):
    """A frame whose field did not travel: to pack it for the line takes longer than to compute it."""

    core_field: Field | None = None

    @cached_property
    def field(self) -> Field | None:
        """Force at every node, with displacement and slip."""
        return self.core_field


class CoreSensor:
    """The core of one pad. Frames are numbered from 0.

    Parameters
    ----------
    noise_m : standard deviation of the displacement along x, y, z; 0: bit for bit what the mechanics say.

    Raises
    ------
    InputError
        The core refuses the calibration, or makes no forces with it.
    """

    def __init__(
        self, board: Board, name: str, number: int, calibration: bytes, noise_m: tuple[float, float, float], seed: int
    ) -> None:
        self._board, self._name, self._number = board, name, number
        self._pipeline = Pipeline(board, calibration)
        if missing := [slot for slot in SLOTS if slot not in self._pipeline.slots]:
            self._pipeline.close()
            raise InputError(
                f"with its calibration board {board.name!r} makes no {', '.join(missing)} of displacements: give pad "
                f"{name!r} a calibration with an operator"
            )
        self._is_measured = [axis not in board.board.not_measured for axis in AXES]
        self._noise, self._seed = np.array(noise_m), seed
        self._limit = board.pad.thickness_um * 1e-6 / 2 / DISPLACEMENT_LSB_M
        self.reset()

    def close(self) -> None:
        self._pipeline.close()

    def reset(self, seed: int | None = None) -> None:
        """Nothing has touched it; frames begin again."""
        self._seed = self._seed if seed is None else seed
        self._rng = np.random.default_rng([self._seed, self._number])
        self._frame = 0
        shape = self._pipeline.layout.node_n_x * self._pipeline.layout.node_n_y
        self._pipeline.solve(np.zeros((1, shape, 3), np.int16))

    def feel(self, displacement: Array, time_s: float) -> SensorFrame:
        """The frame of displacements (n, 3), metres, of the board's observed nodes."""
        steps = np.round((displacement + self._rng.normal(size=displacement.shape) * self._noise) / DISPLACEMENT_LSB_M)
        flags = OVER_RANGE if np.abs(steps).max() > self._limit else 0
        flags |= 0 if self._is_measured[2] else UNCALIBRATED_Z
        steps = np.clip(steps, -LARGEST_STEPS, LARGEST_STEPS).astype(np.int16)
        force = self._pipeline.solve(steps[None])[0]
        number, self._frame = self._frame, self._frame + 1
        return self._as_frame(force, steps, flags, number, time_s)

    def _as_frame(
        self, force: npt.NDArray[np.int32], steps: npt.NDArray[np.int16], flags: int, number: int, time_s: float
    ) -> SensorFrame:
        schema, layout = Schema.own(), self._pipeline.layout
        usual = INVALID if flags & OVER_RANGE else VALID
        validity = [usual if is_measured else NOT_MEASURED for is_measured in self._is_measured]
        has_slip = validity[:3] == [VALID] * 3  # made of shear and pressure
        stamp = {"capture_us": round(time_s * 1e6), "frame": number, "flags": flags}
        names = [f"{axis}_un" if "force" in axis else f"{axis}_un_um" for axis in AXES]
        wrench = dict(zip(names, self._pipeline.raw("wrench").tolist(), strict=True))
        contacts = [
            {"id": i, "area_um2_k": round(row.area_um2 / 1000), "center_x_um": row.center_x_um,
             "center_y_um": row.center_y_um, "force_x_un": row.force_x_un, "force_y_un": row.force_y_un,
             "force_z_un": row.force_z_un, "peak_depth_nm": row.peak_depth_nm, "validity": validity[2],
             "reaches_border": bool(row.reaches_border)}
            | ({"slip": {"slip_state": row.slip_state, "shear_ratio_1e3": row.shear_ratio_1e3,
                         "friction_1e3": row.friction_1e3, "friction_sigma_1e3": row.friction_sigma_1e3,
                         "slip_share_1e3": row.slip_share_1e3, "slip_margin_un": row.slip_margin_un}}
               if has_slip and row.slip_state else {})
            for i, row in enumerate(self._pipeline.contacts())
        ]  # fmt: skip

        messages = {
            "WRENCH": schema.new("Wrench", stamp=stamp, validity=validity, **wrench),
            "CONTACTS": schema.new("Contacts", stamp=stamp, contacts=contacts, n_found=len(contacts)),
        }
        grid = (layout.node_n_y, layout.node_n_x)
        lsb = layout.force_lsb_un * 1e-6
        moved = np.asarray(steps.reshape(*grid, 3) * DISPLACEMENT_LSB_M, np.float64)
        field = Field(
            time_s, number, flags, force.reshape(*grid, 3) * lsb, force.reshape(*grid, 3), lsb,
            moved, tuple(validity[:3]),
            self._pipeline.raw("slip").astype(np.int32) if has_slip else None,
        )  # fmt: skip
        flag_names = tuple(schema.enum_names("FlagBit", flags))
        return CoreFrame(
            f"simulated-{self._name}", self._number, number, time_s, None, None, flags, flag_names, True, False,
            messages, core_field=field,
        )  # fmt: skip
