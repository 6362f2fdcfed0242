"""What targets on a rigid tray show beyond first order: perspective and turns, from the board's geometry alone.

A load of 8 N brings the targets of a sprung tray 4 % nearer to the camera, so shifts and areas are not linear in it. No
log of single conditions excites every pair of axes; the pinhole knows them all. Only the second order is taken from the
board: the first, and with it the unit's own springs and places, is the fit's.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.estimators.wrench.log import features_of

Array = npt.NDArray[np.float64]

PAIRS = np.triu_indices(6)
N_SAMPLES = 600
Q16, Q8 = 65536.0, 256.0


class TargetGeometry:
    """Features (px Q16, px^2 Q8) of the targets of a board for a pose of the tray: shift (mm) and turn (rad)."""

    def __init__(self, board: Board) -> None:
        targets, camera, pad = board.targets, board.camera, board.pad
        assert targets is not None
        middle = np.array([pad.size_x_um, pad.size_y_um]) / 2
        self._places = np.array([[*(np.array(at) - middle), -targets.below_um] for at in targets.places_um]) * 1e-3
        self._focal_px, self._standoff_mm = camera.focal_mpx * 1e-3, camera.standoff_um * 1e-3
        self._radius_mm = targets.diameter_um * 0.5e-3
        self._rest = self._seen(np.zeros((1, 6)))

    def features(self, pose: Array) -> Array:
        """(t, 3 n) changes against rest for poses (t, 6)."""
        return self._seen(pose) - self._rest

    def _seen(self, pose: Array) -> Array:
        at = self._places @ _turned(pose[:, 3:]).transpose(0, 2, 1) + pose[:, None, :3]
        distance = self._standoff_mm + at[..., 2]
        x, y = (self._focal_px * at[..., i] / distance for i in (0, 1))
        area = np.pi * (self._focal_px * self._radius_mm / distance) ** 2
        return np.asarray(np.stack([x * Q16, y * Q16, area * Q8], axis=-1).reshape(len(pose), -1))

    def second_order(self, forward: Array) -> Array:
        """What products u_j u_k add to the features, (n, 21), where u makes `forward` u of them at first (n, 6)."""
        steps = 1e-4 * np.eye(6)
        jacobian = (self.features(steps) - self.features(-steps)).T / 2e-4
        pose_of_u = np.linalg.lstsq(jacobian, forward, rcond=None)[0]
        u = np.random.default_rng(1).uniform(-1, 1, (N_SAMPLES, 6))
        pose = u @ pose_of_u.T
        beyond = self.features(pose) - pose @ jacobian.T
        return np.asarray(np.linalg.lstsq(u[:, PAIRS[0]] * u[:, PAIRS[1]], beyond, rcond=None)[0].T)


def second_order_of(board: Board) -> Callable[[Array], Array] | None:
    """`TargetGeometry.second_order` where the board's features are targets."""
    return TargetGeometry(board).second_order if features_of(board).sort == "targets" else None


def _turned(turn: Array) -> Array:
    """Rotation matrices (t, 3, 3) of rotation vectors (t, 3)."""
    angle = np.linalg.norm(turn, axis=1)[:, None, None]
    x, y, z = turn.T
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    safe = np.maximum(angle, 1e-12)
    return np.asarray(np.eye(3) + np.sin(angle) / safe * cross + (1 - np.cos(angle)) / safe**2 * cross @ cross)
