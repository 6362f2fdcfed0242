"""Where an indenter is, and how its points move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError
from ruffini.sim.indenters import Indenter

Array = npt.NDArray[np.float64]

MAX_TILT_RAD = 0.45  # of shapes that are no ball; their sides would hang over
TILT_ROUNDS = 30
TILT_TOLERANCE = 1e-6  # of the indenter's size


@dataclass(frozen=True)
class Pose:
    """Axis (x, y), depth of the lowest point below the surface when upright, turn about z.

    Then it rolls about x and pitches about y (in the pad's axes) about its pivot (`Indenter.pivot_m`).
    """

    x_m: float
    y_m: float
    depth_m: float
    turn_rad: float = 0.0
    roll_rad: float = 0.0
    pitch_rad: float = 0.0

    def row(self) -> Array:
        """x, y, depth (m), turn, roll, pitch (rad), (6,)."""
        return np.array([self.x_m, self.y_m, self.depth_m, self.turn_rad, self.roll_rad, self.pitch_rad])

    def towards(self, end: Pose, part: float) -> Pose:
        """The pose at `part` (0 to 1) of the straight way to `end`."""
        start, stop = self.row(), end.row()
        return Pose(*(start + part * (stop - start)).tolist())

    def pivot(self, indenter: Indenter) -> Array:
        """Place of the pivot in the pad's frame, (3,)."""
        return np.array([self.x_m, self.y_m, indenter.pivot_m - self.depth_m])

    def rotation(self) -> Array:
        """From the indenter's axes to the pad's, (3, 3): turn, then roll, then pitch."""
        (ct, st), (cr, sr), (cp, sp) = ((np.cos(a), np.sin(a)) for a in self.row()[3:])
        turn = np.array([[ct, -st, 0], [st, ct, 0], [0, 0, 1]])
        roll = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
        pitch = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
        return np.asarray(pitch @ roll @ turn)


def surface_height(indenter: Indenter, pose: Pose, place: Array) -> Array:
    """Height (m) of an indenter's surface over the undeformed pad's at (x, y) = place (n, 2).

    Raises
    ------
    InputError
        It is tilted so far that its surface hangs over.
    """
    dx, dy = place[:, 0] - pose.x_m, place[:, 1] - pose.y_m
    if indenter.shape == "sphere" or not (pose.roll_rad or pose.pitch_rad):
        c, s = np.cos(pose.turn_rad), np.sin(pose.turn_rad)
        return indenter.height(c * dx + s * dy, c * dy - s * dx) - pose.depth_m
    if indenter.shape == "cylinder" and pose.roll_rad == 0 and np.isclose(np.sin(pose.turn_rad), 0):
        return indenter.height(dx, dy) - pose.depth_m  # it rolls about its own axis
    if np.hypot(pose.roll_rad, pose.pitch_rad) > MAX_TILT_RAD:
        raise InputError(
            f"an indenter tilted by {np.hypot(pose.roll_rad, pose.pitch_rad):.2f} rad cannot be pressed: "
            f"at most {MAX_TILT_RAD} rad, so that its sides do not hang over"
        )
    # A point (dx, dy, z) seen from the pivot lies on the surface where its own height is the shape's:
    # (R^T (dx, dy, z))_z = height(..) - pivot. Secant steps, all places at once.
    r, pivot = pose.rotation(), indenter.pivot_m
    z = indenter.height(dx, dy) - pivot
    for _ in range(TILT_ROUNDS):
        x, y, own = (r[0, c] * dx + r[1, c] * dy + r[2, c] * z for c in range(3))
        lack = indenter.height(x, y) - pivot - own
        z = z + 0.8 * lack / r[2, 2]
        if np.abs(lack).max() < TILT_TOLERANCE * indenter.radius_m:
            break
    return np.asarray(z + pivot - pose.depth_m)


def rigid_step(indenter: Indenter, before: Pose, after: Pose, point: Array) -> Array:
    """Displacement (n, 3) of points (n, 3) that go rigidly with the indenter from one pose to the next."""
    spin = after.rotation() @ before.rotation().T
    return np.asarray((point - before.pivot(indenter)) @ spin.T + after.pivot(indenter) - point)
