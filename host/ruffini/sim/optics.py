"""What the camera sees: a pinhole below the pad, three near LEDs, printed dots, sensor noise.

Geometry (firmware/README.md): the camera is at z = -H on the axis, x right, y down, looking along +z.
Shading is Lambertian with exact normals of the deformed surface; light falls with distance squared.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import RectBivariateSpline

from ruffini.boards import Board
from ruffini.sim.pad import PadModel
from ruffini.sim.settings import TwinSettings

Array = npt.NDArray[np.float64]
FINE_STEP_MM = 0.05  # of the grid on which the surface is looked up
RAY_TOLERANCE_MM = 0.5e-3  # of the ray's fixed point: below 0.01 px
MAX_RAY_ROUNDS = 40  # where the surface hides a part of itself there is no fixed point


@dataclass
class Renderer:
    """Pictures of one simulated unit. Reusable for any displacement of the same pad model."""

    board: Board
    twin: TwinSettings
    model: PadModel
    has_dots: bool = True

    def __post_init__(self) -> None:
        camera = self.board.camera
        v, u = np.mgrid[: camera.height_px, : camera.width_px].astype(float)
        self._ray_x = (u - camera.center_x_mpx / 1e3) * 1e3 / camera.focal_mpx
        self._ray_y = (v - camera.center_y_mpx / 1e3) * 1e3 / camera.focal_mpx
        self._height_mm = camera.standoff_um * 1e-3
        half_x, half_y = self.model.size_x_m * 500, self.model.size_y_m * 500
        self._fine_x = np.arange(-half_x, half_x + FINE_STEP_MM / 2, FINE_STEP_MM)
        self._fine_y = np.arange(-half_y, half_y + FINE_STEP_MM / 2, FINE_STEP_MM)
        radius2 = self._ray_x**2 + self._ray_y**2
        self._vignette = 1 - self.twin.light.vignette_1e3 * 1e-3 * radius2 / radius2.max()
        self._gain, self._ambient = 1.0, 0.0
        at_rest = np.zeros((*self.model.shape, 3))
        light = self.twin.light
        self._ambient = light.ambient_1e3 * 1e-3 * float(self._shade(at_rest, dots=False).mean())
        self._gain = light.mean_level / float(self._shade(at_rest, dots=False).mean())

    def image(self, displacement_m: Array, rng: np.random.Generator) -> npt.NDArray[np.uint8]:
        """One frame, (h, w, 3) uint8 B G R, of a surface displacement (n_nodes, 3) in metres."""
        light = self._shade(displacement_m.reshape(*self.model.shape, 3), dots=self.has_dots)
        noise = self.twin.noise
        sigma = np.sqrt((noise.read_1e3 * 1e-3) ** 2 + noise.shot_1e3 * 1e-3 * light)
        noisy = light + sigma * rng.standard_normal(light.shape, dtype=np.float32)
        return np.asarray(np.clip(np.round(noisy), 0, 255), dtype=np.uint8)

    def depth_mm(self, displacement_m: Array) -> Array:
        """u_z along each pixel's ray, (h, w), millimetres: what a perfect depth stage would say."""
        maps = self._surface(displacement_m.reshape(*self.model.shape, 3))
        x, y = self._material_points(maps)
        return self._look(maps[2], x, y)

    def _surface(self, displacement_m: Array) -> list[npt.NDArray[np.float32]]:
        """u_x, u_y, u_z (mm) and their six in-plane derivatives on the fine grid."""
        node_x, node_y = self.model.node_x() * 1e3, self.model.node_y() * 1e3
        values, slopes = [], []
        for c in range(3):
            spline = RectBivariateSpline(node_y, node_x, displacement_m[:, :, c] * 1e3)
            values.append(spline(self._fine_y, self._fine_x).astype(np.float32))
            slopes.append(spline(self._fine_y, self._fine_x, dy=1).astype(np.float32))
            slopes.append(spline(self._fine_y, self._fine_x, dx=1).astype(np.float32))
        return values + slopes

    def _look(self, grid: npt.NDArray[np.float32], x: Array, y: Array) -> Array:
        import cv2

        u = ((x - self._fine_x[0]) / FINE_STEP_MM).astype(np.float32)
        v = ((y - self._fine_y[0]) / FINE_STEP_MM).astype(np.float32)
        return np.asarray(cv2.remap(grid, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), dtype=float)

    def _material_points(self, maps: list[npt.NDArray[np.float32]]) -> tuple[Array, Array]:
        """Undeformed place (mm) of the surface point that each pixel sees."""
        x, y = self._ray_x * self._height_mm, self._ray_y * self._height_mm
        for _ in range(MAX_RAY_ROUNDS):
            distance = self._height_mm + self._look(maps[2], x, y)
            next_x = self._ray_x * distance - self._look(maps[0], x, y)
            next_y = self._ray_y * distance - self._look(maps[1], x, y)
            change = max(np.abs(next_x - x).max(), np.abs(next_y - y).max())
            x, y = next_x, next_y
            if change < RAY_TOLERANCE_MM:
                break
        return x, y

    def _shade(self, displacement_m: Array, *, dots: bool) -> npt.NDArray[np.float32]:
        maps = self._surface(displacement_m)
        x, y = self._material_points(maps)
        ux, uy, uz, ux_x, ux_y, uy_x, uy_y, uz_x, uz_y = (self._look(m, x, y) for m in maps)
        # Inward normal: minus the cross product of the deformed surface's tangents.
        normal = -np.stack(
            [
                uy_x * uz_y - uz_x * (1 + uy_y),
                uz_x * ux_y - (1 + ux_x) * uz_y,
                (1 + ux_x) * (1 + uy_y) - uy_x * ux_y,
            ],
            axis=-1,
        )
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        point = np.stack([x + ux, y + uy, uz], axis=-1)
        light = self.twin.light
        single = []
        for place, power in zip((light.led_b_um, light.led_g_um, light.led_r_um), light.power_1e3, strict=True):
            to_led = np.array(place) * 1e-3 - point
            distance2 = (to_led**2).sum(axis=-1)
            cosine = np.maximum((normal * to_led).sum(axis=-1), 0) / np.sqrt(distance2)
            single.append(power * 1e-3 * cosine / distance2)
        leak = light.crosstalk_1e3 * 1e-3
        total = np.sum(single, axis=0)
        channels = np.stack([(1 - 3 * leak) * s + leak * total for s in single], axis=-1) + self._ambient
        channels *= (self._vignette * self._gain)[..., None]
        if dots:
            channels *= (1 - self.twin.dots.darkness_1e3 * 1e-3 * self._dot_cover(x, y))[..., None]
        return channels.astype(np.float32)

    def _dot_cover(self, x_mm: Array, y_mm: Array) -> Array:
        """How much of each pixel is printed, 0 to 1, at material places."""
        markers, unit = self.board.markers, self.twin.unit
        turn = unit.lattice_turn_mrad * 1e-3
        x = np.cos(turn) * x_mm + np.sin(turn) * y_mm - unit.lattice_shift_um[0] * 1e-3
        y = -np.sin(turn) * x_mm + np.cos(turn) * y_mm - unit.lattice_shift_um[1] * 1e-3
        pad = self.board.pad

        def offset(place: Array, size_um: int, first_um: int, pitch_um: int, n: int) -> Array:
            steps = (place + size_um * 5e-4 - first_um * 1e-3) / (pitch_um * 1e-3)
            return np.asarray((steps - np.clip(np.round(steps), 0, n - 1)) * pitch_um * 1e-3)

        dx = offset(x, pad.size_x_um, markers.first_x_um, markers.pitch_x_um, markers.n_x)
        dy = offset(y, pad.size_y_um, markers.first_y_um, markers.pitch_y_um, markers.n_y)
        edge = (markers.diameter_um * 5e-4 - np.hypot(dx, dy)) / (self.twin.dots.blur_um * 1e-3)
        return np.asarray(np.clip(edge + 0.5, 0, 1))
