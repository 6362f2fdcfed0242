"""Two eyes behind a round fingertip: where a pin is in space, where a point is in the frame, which dots are one pin.

The eyes look along +z of the pad's frame, `standoff` behind the top of the dome, side by side along x; the frame holds
the left eye's view, then the right one's. Millimetres and pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.errors import InputError

Array = npt.NDArray[np.float64]

PIN_RADII = np.arange(0.75, 1.0, 0.005)  # of the dome's: where the pins' tips may stand
PAIR_PX = 1.5  # between a dot of the right eye and where the left one's pin should be
RADIAL_MM, SIDEWAYS_MM, NOISE_PX = 1.0, 0.15, 0.02  # what one eye takes for likely of a pin


@dataclass(frozen=True)
class Eyes:
    """Both eyes' pinholes: focal length, principal point in a view, px; distances, mm."""

    focal_px: float
    centre_px: tuple[float, float]
    width_px: int
    standoff_mm: float
    baseline_mm: float
    radius_mm: float  # of the dome's outside

    @classmethod
    def of(cls, board: Board, baseline_mm: float) -> Eyes:
        """As board.toml has them; the distance between them is not in it.

        Raises
        ------
        InputError
            They would not fit in the fingertip.
        """
        camera, most_mm = board.camera, board.pad.size_x_um * 1e-3
        if not 0.1 <= baseline_mm <= most_mm:  # nor is NaN
            raise InputError(
                f"--baseline-mm {baseline_mm:g}: the eyes are 0.1 to {most_mm:g} mm apart, as wide as the fingertip"
            )
        return cls(
            camera.focal_mpx * 1e-3, (camera.center_x_mpx * 1e-3, camera.center_y_mpx * 1e-3), camera.width_px // 2,
            camera.standoff_um * 1e-3, baseline_mm, board.pad.size_x_um * 5e-4,
        )  # fmt: skip

    def place(self, px: Array) -> Array:
        """Points (..., n, 3) that both eyes see at (..., 2, n, 2)."""
        left, right = px[..., 0, :, :], px[..., 1, :, :] - np.array([self.width_px, 0])
        distance = self.focal_px * self.baseline_mm / (left[..., 0] - right[..., 0])
        middle = (left + right) / 2 - np.array(self.centre_px)
        sideways = middle * (distance / self.focal_px)[..., None]
        return np.concatenate([sideways, (distance - self.standoff_mm)[..., None]], axis=-1)

    def project(self, place: Array) -> Array:
        """Pixels (..., 2, n, 2) of points (..., n, 3)."""
        distance, out = place[..., 2] + self.standoff_mm, []
        for eye in range(2):
            x = place[..., 0] + self.baseline_mm * (0.5 - eye)
            out.append(
                np.stack(
                    [self.centre_px[0] + eye * self.width_px + self.focal_px * x / distance,
                     self.centre_px[1] + self.focal_px * place[..., 1] / distance], axis=-1,
                )
            )  # fmt: skip
        return np.stack(out, axis=-3)

    def normals(self, place: Array) -> Array:
        """Directions (n, 3) of points from the middle of the sphere."""
        out = place + np.array([0, 0, self.radius_mm])
        return np.asarray(out / np.linalg.norm(out, axis=-1, keepdims=True))

    def gains(self, place: Array) -> Array:
        """mm per px, (3, n, 3, 4): shifts of a pin in both eyes to its displacement; by both, the left, the right.

        One eye alone takes what it does not see for as small as pins usually move.
        """
        step = 1e-3
        moved = place[:, None, :] + step * np.eye(3)  # (n, 3 ways, 3)
        slope = (self.project(moved.transpose(1, 0, 2)) - self.project(place)[None]) / step  # (3, 2, n, 2)
        slopes = slope.transpose(2, 1, 3, 0).reshape(len(place), 4, 3)
        normal, out = self.normals(place), np.zeros((3, len(place), 3, 4))
        out[0] = np.linalg.pinv(slopes)
        along = normal[:, :, None] * normal[:, None, :]
        likely = RADIAL_MM**2 * along + SIDEWAYS_MM**2 * (np.eye(3) - along)
        for eye in range(2):
            seen = slopes[:, 2 * eye : 2 * eye + 2]
            spread = seen @ likely @ seen.transpose(0, 2, 1) + NOISE_PX**2 * np.eye(2)
            out[1 + eye, :, :, 2 * eye : 2 * eye + 2] = likely @ seen.transpose(0, 2, 1) @ np.linalg.inv(spread)
        return out

    def pairs(self, left: Array, right: Array) -> npt.NDArray[np.intp]:
        """Which dots (n, 2) of the left view and of the right one are the same pins, (m, 2) numbers.

        Pins' tips stand on a sphere about the dome's middle, whose radius is found by how well dots then meet.

        Raises
        ------
        InputError
            Fewer than half of them meet.
        """
        best: tuple[float, npt.NDArray[np.intp]] = (-np.inf, np.zeros((0, 2), dtype=np.intp))
        for part in PIN_RADII:
            foretold = self.project(self._on_sphere(left, part * self.radius_mm))[1]
            apart = np.linalg.norm(foretold[:, None] - right[None], axis=2)
            to_right, to_left = apart.argmin(axis=1), apart.argmin(axis=0)
            both = np.flatnonzero(to_left[to_right] == np.arange(len(left)))
            near = apart[both, to_right[both]]
            found = np.stack([both, to_right[both]], axis=1)[near < PAIR_PX]
            score = float(np.maximum(1 - near / PAIR_PX, 0).sum())
            if score > best[0]:
                best = score, found
        if 2 * len(best[1]) < max(len(left), len(right)):
            raise InputError(
                "most pins of one eye are not where the other has them: check the distance between the eyes"
            )
        return best[1]

    def _on_sphere(self, left: Array, radius_mm: float) -> Array:
        """Where the left eye's rays through pixels (n, 2) leave a sphere about the dome's middle."""
        ray = np.column_stack([(left - np.array(self.centre_px)) / self.focal_px, np.ones(len(left))])
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        start = np.array([-self.baseline_mm / 2, 0, -self.standoff_mm + self.radius_mm])  # from the sphere's middle
        along = ray @ start
        root = np.sqrt(np.maximum(along**2 - (start @ start - radius_mm**2), 0))
        return np.asarray(start + (root - along)[:, None] * ray - [0, 0, self.radius_mm])
