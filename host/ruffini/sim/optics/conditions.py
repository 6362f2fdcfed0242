"""What can go wrong with the optics of a running sensor, and where a tray stands that carries the pad."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Conditions:
    """Optics of one frame; the defaults are a healthy sensor.

    exposure : factor on all light; lamps_off : numbers of dark lamps; is_capped : nothing gets in;
    tear_um : middle x, y and radius of a hole in the coating, through which the room is seen;
    leak : daylight that enters from the left edge, over the mean level; is_unlit : all lamps are switched off.
    """

    exposure: float = 1.0
    lamps_off: tuple[int, ...] = ()
    is_capped: bool = False
    tear_um: tuple[int, int, int] | None = None
    leak: float = 0.0
    is_unlit: bool = False


@dataclass(frozen=True)
class TrayPose:
    """Rigid displacement of the tray with pad, lamps apart: shift (m), small rotation vector (rad)."""

    shift_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turn_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def row(self) -> Array:
        """Shift (m) and turn (rad), (6,)."""
        return np.array([*self.shift_m, *self.turn_rad])

    def matrix(self) -> Array:
        """Rotation, (3, 3), by Rodrigues' formula."""
        vector = np.array(self.turn_rad)
        angle = float(np.linalg.norm(vector))
        if angle == 0:
            return np.eye(3)
        x, y, z = vector / angle
        k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        return np.asarray(np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k)
