"""The mounting of a reference: its rotation against the pad, its offset from the pad's centre, and its dead load.

With F the force ON the pad and p the place of the contact, both in the pad's frame, a six-axis reference reads

    f = R F + f0,   t = (R p + a) x (R F) + t0

with its rotation R, the pad's centre a in its frame, and its dead load f0, t0, which the samples at rest give. a is
determined except for a shift along the force, if all forces have the same direction.
"""

from __future__ import annotations

import warnings
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from ruffini.errors import InputError
from ruffini.rig.reference import AXES

Array = npt.NDArray[np.float64]

MIN_TOUCHES, MIN_REST = 6, 5
MAX_SIGMA_TURN_RAD, MAX_SIGMA_ARM_M = 0.02, 1e-3
UNKNOWN_ARM_M = 0.05  # prior on the arm: it keeps finite what the presses do not reveal, and weighs nothing else


class FrameFit(NamedTuple):
    """Turn (3, 3) from the pad's axes to the reference's, arm (3,) m, wrench (6,) of what hangs on it; sigmas."""

    rotation: Array
    arm_m: Array
    hanging: Array
    turn_sigma_rad: Array  # (3,) about x, y, z
    arm_sigma_m: Array  # (3,)
    force_rmse_n: float
    torque_rmse_nm: float

    @property
    def turn_rad(self) -> float:
        """Angle between both frames."""
        return float(Rotation.from_matrix(self.rotation).magnitude())

    def to_pad(self, wrench: Array) -> Array:
        """Readings (n, 6) of the reference as wrenches ON the pad about its centre."""
        force = (wrench[:, :3] - self.hanging[:3]) @ self.rotation
        torque = (wrench[:, 3:] - self.hanging[3:]) @ self.rotation
        return np.hstack([force, torque - np.cross(self.arm_m @ self.rotation, force)])


def fit_frame(
    rest: Array, reading: Array, place_m: Array, direction: Array, sigma: Array, *, direction_sigma: float = 0.05
) -> FrameFit:
    """Fit R, a, f0 and t0.

    Parameters
    ----------
    rest : (k, 6)
        Readings while nothing touches, N and N m.
    reading : (n, 6)
        One settled reading for each touch.
    place_m : (n, 3)
        Where each touched, in the pad's frame: the stage's place of the tip.
    direction : (n, 3)
        Force on the pad as the sensor has it: its direction is used, its size is not.
    sigma : (6,)
        The reference's standard uncertainty.

    Raises
    ------
    InputError
        Too few, an axis missing, or the touches leave the turn or the arm open: the text says which touches to add.
    """
    if len(reading) < MIN_TOUCHES or len(rest) < MIN_REST:
        raise InputError(f"{len(reading)} touches and {len(rest)} readings at rest: {MIN_TOUCHES} and {MIN_REST} are "
                         "needed to find where the reference stands")  # fmt: skip
    missing = [AXES[i] for i in np.flatnonzero(np.isnan(reading).any(axis=0))]
    if missing:
        raise InputError(f"the reference has no {', '.join(missing)}: only one with six axes tells where it stands")
    hanging = rest.mean(axis=0)
    net = reading - hanging
    force, torque = net[:, :3], net[:, 3:]
    size = np.linalg.norm(force, axis=1)
    unit = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    starts = _starts(force / size[:, None], unit)

    def residual(p: Array, start: Rotation) -> Array:
        turn = Rotation.from_rotvec(p[:3]) * start
        arm = p[3:]
        lever = turn.apply(place_m) + arm
        torque_sigma = sigma[3:] + 1e-4 * size[:, None]  # a tenth of a millimetre of what the contact's place is off
        return np.concatenate([
            ((force / size[:, None] - turn.apply(unit)) / direction_sigma).ravel(),
            ((torque - np.cross(lever, force)) / torque_sigma).ravel(),
            arm / UNKNOWN_ARM_M,
        ])  # fmt: skip

    def fitted(start: Rotation, arm: Array) -> Any:
        return least_squares(
            residual, np.concatenate([np.zeros(3), arm]), x_scale=[0.1] * 3 + [0.01] * 3, args=(start,)
        )

    fits = [fitted(start, np.zeros(3)) for start in starts]
    best = int(np.argmin([f.cost for f in fits]))
    # Once more from there: far from its start a turn's components are not those of a small turn, nor their sigmas.
    start = Rotation.from_rotvec(fits[best].x[:3]) * starts[best]
    fit = fitted(start, fits[best].x[3:])
    spread = np.sqrt(np.diag(np.linalg.inv(fit.jac.T @ fit.jac)) * max(1.0, 2 * fit.cost / (6 * len(reading) - 6)))
    _check(spread)
    rotation = Rotation.from_rotvec(fit.x[:3]) * start
    lever = rotation.apply(place_m) + fit.x[3:]
    return FrameFit(
        rotation.as_matrix(), fit.x[3:], hanging, spread[:3], spread[3:],
        float(np.sqrt(((force - size[:, None] * rotation.apply(unit)) ** 2).sum(axis=1).mean())),
        float(np.sqrt(((torque - np.cross(lever, force)) ** 2).sum(axis=1).mean())),
    )  # fmt: skip


def _starts(seen: Array, unit: Array) -> list[Rotation]:
    """Turns to begin with. Straight presses do not tell the turn about their own direction: four are tried."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        first, _ = Rotation.align_vectors(seen, unit)
    axis = seen.mean(axis=0) / np.linalg.norm(seen.mean(axis=0))
    return [Rotation.from_rotvec(k * np.pi / 2 * axis) * first for k in range(4)]


def _check(spread: Array) -> None:
    turn, arm = spread[:3], spread[3:]
    if turn.max() > MAX_SIGMA_TURN_RAD:
        raise InputError(
            f"the touches leave the reference's turn about {'xyz'[int(turn.argmax())]} open by "
            f"{np.rad2deg(turn.max()):.1f} deg: add touches far from the centre, and with shear"
        )
    if arm.max() > MAX_SIGMA_ARM_M:
        raise InputError(f"the touches leave the pad's place in the reference's {'xyz'[int(arm.argmax())]} open by "
                         f"{1e3 * arm.max():.1f} mm: add touches with shear along x and along y")  # fmt: skip
