"""Results of the stream in SI units."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.wire.dense import decode_dense

Array = npt.NDArray[np.float64]
NOT_MEASURED, VALID, UNCALIBRATED, INVALID = range(4)


def _dense(message: Any) -> npt.NDArray[np.int32]:
    return decode_dense(message.codec, message.n_x, message.n_y, message.n_components, message.data)


@dataclass(frozen=True)
class Wrench:
    """Force (N) and moment (N m) ON the pad about the undeformed pad centre; NaN where not measured."""

    capture_s: float
    frame: int
    flags: int
    values: Array
    validity: tuple[int, ...]

    @classmethod
    def from_message(cls, m: Any) -> Wrench:
        raw = np.array(
            [m.force_x_un, m.force_y_un, m.force_z_un, m.torque_x_un_um, m.torque_y_un_um, m.torque_z_un_um],
            float,
        )
        values = raw * np.array([1e-6] * 3 + [1e-12] * 3)
        validity = tuple(m.validity) or (NOT_MEASURED,) * 6
        values[np.array(validity) == NOT_MEASURED] = np.nan
        return cls(m.stamp.capture_us * 1e-6, m.stamp.frame, m.stamp.flags, values, validity)


@dataclass(frozen=True)
class Field:
    """Nodal force (n_y, n_x, 3) in newtons and displacement in metres on the observed nodes."""

    capture_s: float
    frame: int
    flags: int
    force: Array
    force_steps: npt.NDArray[np.int32]
    force_lsb_n: float
    displacement: Array | None
    validity: tuple[int, ...]

    @classmethod
    def from_message(cls, m: Any) -> Field:
        steps = _dense(m.force)
        lsb = m.force_lsb_un * 1e-6
        displacement = _dense(m.displacement) * (m.displacement_lsb_nm * 1e-9) if m.HasField("displacement") else None
        return cls(
            m.stamp.capture_us * 1e-6, m.stamp.frame, m.stamp.flags, steps * lsb, steps, lsb, displacement,
            tuple(m.validity),
        )  # fmt: skip


@dataclass(frozen=True)
class Depth:
    """u_z along the pixels' rays on the depth grid, (n_y, n_x), metres."""

    capture_s: float
    frame: int
    flags: int
    depth: Array
    validity: int

    @classmethod
    def from_message(cls, m: Any) -> Depth:
        depth = _dense(m.depth)[..., 0] * (m.depth_lsb_nm * 1e-9)
        return cls(m.stamp.capture_us * 1e-6, m.stamp.frame, m.stamp.flags, depth, m.validity)


@dataclass(frozen=True)
class Image:
    """The camera's frame, (h, w, 3) uint8, B G R; every step_px-th pixel of it where it does not fit a message."""

    capture_s: float
    frame: int
    flags: int
    pixels: npt.NDArray[np.uint8]
    step_px: int

    @classmethod
    def from_message(cls, m: Any) -> Image:
        pixels = np.frombuffer(m.data, np.uint8).reshape(m.height_px, m.width_px, 3)
        return cls(m.stamp.capture_us * 1e-6, m.stamp.frame, m.stamp.flags, pixels, m.step_px)


RESULTS: dict[str, Any] = {"WRENCH": Wrench, "FIELD": Field, "DEPTH": Depth, "IMAGE": Image}
