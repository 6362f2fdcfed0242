"""Rendered ball presses beside recorded ones: does the twin's picture of a press look like a real one?

The recording gives pictures and hand-marked contact circles, no forces, no lamps and no thickness. So the lamps of
the twin (places, powers, diffuse light) and its thickness are fitted on half of the presses and judged on the other
half: what is judged is the shape of the gel inside and outside the contact, and whether three near lamps can make
those colours from it. Assumed: Poisson's ratio 0.48, pinhole 25 mm from the surface.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from ruffini.boards import Board
from ruffini.boards.pictures import picture_board
from ruffini.errors import InputError
from ruffini.estimators.photometric.presses import Press, PressSet
from ruffini.frames import read_image
from ruffini.sim.contact import Indenter, Pose
from ruffini.sim.settings import TwinSettings
from ruffini.sim.surface import hat_areas
from ruffini.sim.unit import TwinUnit
from ruffini.tables import aligned

Array = npt.NDArray[np.float64]
STANDOFF_MM = 25.0
THICKNESSES_UM = (4000, 7000, 10_000)  # that are tried
MESH = {"cells_x": 20, "cells_y": 26}
MARGIN_MM = 3.0  # of pad beyond the picture
DEPTH_STEP_M = 0.1e-3
SAMPLE_STEP_PX = 7  # of the pixels that the lamps are fitted on
RINGS = ((0.0, 0.85), (0.85, 1.15), (1.15, 2.0), (2.0, 3.0))  # contact radii, judged apart


def board_of(presses: PressSet, thickness_um: int) -> Board:
    """A board of the recording's size and scale."""
    return picture_board(
        presses.reference.shape, presses.px_per_mm, ["difference"],
        name="recorded", standoff_mm=STANDOFF_MM, margin_mm=MARGIN_MM, thickness_um=thickness_um,
    )  # fmt: skip


@dataclass
class Lamps:
    """Places of the B, G and R lamps (mm), their powers, diffuse light and crosstalk: what is fitted."""

    place_mm: Array
    power: Array
    ambient: float
    crosstalk: float

    @classmethod
    def unpack(cls, x: Array) -> Lamps:
        return cls(x[:9].reshape(3, 3), x[9:12], float(x[12]), float(x[13]))

    def settings(self, mean_level: float) -> TwinSettings:
        """The same lamps as a twin.toml has them."""
        um = np.round(self.place_mm * 1e3).astype(int).tolist()
        return TwinSettings.model_validate(
            {
                "schema": 1,
                "unit": {"lattice_shift_um": [0, 0], "lattice_turn_mrad": 0, "friction_1e3": 700},
                "light": {
                    "kind": "rgb_leds", "led_b_um": um[0], "led_g_um": um[1], "led_r_um": um[2],
                    "power_1e3": [round(1000 * p) for p in self.power / self.power.mean()],
                    "ambient_1e3": round(1000 * self.ambient), "crosstalk_1e3": round(1000 * self.crosstalk),
                    "mean_level": round(mean_level),
                },
                "noise": {"read_1e3": 0, "shot_1e3": 0},
                "mesh": MESH,
            }
        )  # fmt: skip


# Where the fit starts: lamps 20 mm out and 8 mm down, where the reference is brightest in each colour.
START = np.array([-20, 0, -8, 0, 20, -8, 5, -20, -8, 1, 1, 1, 0.5, 0.1], dtype=float)
LOW = np.array([-60, -60, -60, -60, -60, -60, -60, -60, -60, 0.2, 0.2, 0.2, 0.0, 0.0])
HIGH = np.array([60, 60, -0.5, 60, 60, -0.5, 60, 60, -0.5, 5, 5, 5, 10.0, 0.3])
SCALE = np.array([10.0] * 9 + [0.5] * 3 + [0.2, 0.05])


@dataclass(frozen=True)
class Scene:
    """One press on the twin: displacement (n, 3) m, and what the pixels see of it, (h, w, 3)."""

    press: Press
    displacement: Array
    point: Array
    normal: Array


def scenes(presses: PressSet, unit: TwinUnit) -> list[Scene]:
    """Press the twin's ball where the recorded one was, as deep as gives the marked contact circle."""
    ball, renderer = Indenter("sphere", presses.ball_mm / 2e3), unit.renderer()
    height, width = presses.reference.shape[:2]
    found = []
    for press in presses.presses:
        x_m = (press.center_x_px - (width - 1) / 2) / presses.px_per_mm * 1e-3
        y_m = (press.center_y_px - (height - 1) / 2) / presses.px_per_mm * 1e-3
        solver, depth_m, wanted_m = unit.solver(ball), 0.0, press.radius_px / presses.px_per_mm * 1e-3
        while np.sqrt(hat_areas(unit.model)[solver.hat_force[:, 2] < 0].sum() / np.pi) < wanted_m:
            depth_m += DEPTH_STEP_M
            try:
                solver.advance(Pose(x_m, y_m, depth_m))
            except InputError:
                break  # as deep as the linear model goes
        hits = renderer.surface.deform(solver.displacement).hit(renderer.views[0].origin, renderer.views[0].direction)
        found.append(Scene(press, solver.displacement, hits.point.astype(float), hits.normal.astype(float)))
    return found


def _light(lamps: Lamps, point: Array, normal: Array) -> Array:
    """Light of lamps at points with normals (n, 3): (n, 3) B G R, as `optics.lights.rgb_leds` has it."""
    single = []
    for place, power in zip(lamps.place_mm, lamps.power, strict=True):
        to_lamp = place - point
        distance2 = (to_lamp**2).sum(axis=1)
        single.append(power * np.maximum((normal * to_lamp).sum(axis=1), 0) / distance2**1.5)
    lit = np.stack(single, axis=1)
    lit /= lit.mean()
    return np.asarray((1 - 3 * lamps.crosstalk) * lit + lamps.crosstalk * lit.sum(axis=1, keepdims=True))


def _relative(lamps: Lamps, scene: Scene, rest: Array, pick: npt.NDArray[np.intp]) -> Array:
    """Modelled change of the picked pixels' light, over their light at rest."""
    down = np.tile([0.0, 0.0, -1.0], (len(pick), 1))
    both = _light(lamps, np.vstack([scene.point.reshape(-1, 3)[pick], rest[pick]]),
                  np.vstack([scene.normal.reshape(-1, 3)[pick], down])) + lamps.ambient  # fmt: skip
    return np.asarray(both[: len(pick)] / both[len(pick) :] - 1)


def _distance(press: Press, shape: tuple[int, ...]) -> Array:
    """Of every pixel from the contact's centre, in contact radii."""
    v, u = np.mgrid[: shape[0], : shape[1]]
    return np.asarray(np.hypot(u - press.center_x_px, v - press.center_y_px) / press.radius_px)


def _recorded(presses: PressSet, press: Press) -> Array:
    """Relative change of a recorded press, its exposure set equal to the reference's where the gel is flat."""
    ratio = (read_image(press.path) + 1.0) / (presses.reference + 1.0)
    far = _distance(press, ratio.shape) > RINGS[-1][1]
    return np.asarray(ratio / np.median(ratio[far], axis=0) - 1)


def fit_lamps(presses: PressSet, found: list[Scene]) -> tuple[float, Lamps]:
    """Least squares of relative change on the given presses; also the cost that is left."""
    rest = _rest_points(presses)
    jobs = []
    for scene in found:
        near = (_distance(scene.press, presses.reference.shape) < RINGS[-1][1]).ravel()
        v, u = np.indices(presses.reference.shape[:2])
        on_grid = ((v % SAMPLE_STEP_PX == 0) & (u % SAMPLE_STEP_PX == 0)).ravel()
        pick = np.flatnonzero(near & on_grid)
        jobs.append((scene, pick, _recorded(presses, scene.press).reshape(-1, 3)[pick]))

    def residual(x: Array) -> Array:
        lamps = Lamps.unpack(x)
        return np.concatenate([(_relative(lamps, s, rest, pick) - d).ravel() for s, pick, d in jobs])

    # Dust and scratches are outliers: a soft loss.
    found_x = least_squares(residual, START, bounds=(LOW, HIGH), loss="soft_l1", f_scale=0.1, x_scale=SCALE)
    return float(found_x.cost), Lamps.unpack(found_x.x)


def _rest_points(presses: PressSet) -> Array:
    height, width = presses.reference.shape[:2]
    v, u = np.indices((height, width))
    x, y = ((n - (size - 1) / 2) / presses.px_per_mm for n, size in ((u, width), (v, height)))
    return np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)


def rendered_change(unit: TwinUnit, found: list[Scene]) -> list[Array]:
    """Relative change of each scene as the twin's own camera shows it, (h, w, 3)."""
    renderer, rng = unit.renderer(), np.random.default_rng(0)
    rest = renderer.image(unit.at_rest(), rng).astype(float)
    return [(renderer.image(s.displacement, rng) + 1.0) / (rest + 1.0) - 1 for s in found]


def judge(presses: PressSet, found: list[Scene], rendered: list[Array]) -> list[dict[str, Any]]:
    """One row for each ring: how much of the recorded change the rendered one explains."""
    rows = []
    for low, high in RINGS:
        real, twin = [], []
        for scene, change in zip(found, rendered, strict=True):
            at = _distance(scene.press, change.shape)
            inside = (at >= low) & (at < high)
            real.append(_recorded(presses, scene.press)[inside].ravel())
            twin.append(change[inside].ravel())
        a, b = np.concatenate(real), np.concatenate(twin)
        rows.append({
            "from_radius": low, "to_radius": high, "recorded_rms": float(np.sqrt((a**2).mean())),
            "rendered_rms": float(np.sqrt((b**2).mean())), "difference_rms": float(np.sqrt(((a - b) ** 2).mean())),
            "correlation": float(np.corrcoef(a, b)[0, 1]),
        })  # fmt: skip
    return rows


def table(rows: list[dict[str, Any]]) -> str:
    """The rows as text."""
    text = "relative change of light in rings about the contact (radii), presses that the lamps were not fitted on\n"
    keys = ("recorded_rms", "rendered_rms", "difference_rms", "correlation")
    lines = aligned(("ring", "recorded", "rendered", "difference", "correlation"), [
        (f"{row['from_radius']:.2f}-{row['to_radius']:.2f}", *(f"{row[key]:.3f}" for key in keys)) for row in rows
    ])  # fmt: skip
    return text + "".join(f"{line}\n" for line in lines)


def side_by_side(path: Path, presses: PressSet, found: list[Scene], rendered: list[Array], n: int = 6) -> Path:
    """Recorded change above, rendered below; grey is no change."""
    import cv2

    def picture(change: Array) -> npt.NDArray[np.uint8]:
        return np.asarray(np.clip(128 + 200 * change, 0, 255), dtype=np.uint8)

    rows = [[picture(_recorded(presses, s.press)) for s in found[:n]], [picture(r) for r in rendered[:n]]]
    path.parent.mkdir(parents=True, exist_ok=True)
    if not cv2.imwrite(str(path), np.vstack([np.hstack(row) for row in rows])):
        raise InputError(f"{path} cannot be written: check --out")
    return path


def run(
    presses: PressSet, out: Path | None, progress: Callable[[float], None] = lambda _: None
) -> tuple[dict[str, Any], str]:
    """The whole comparison: numbers and text."""
    mean_level, tried = float(presses.reference.mean()), []
    for i, thickness_um in enumerate(THICKNESSES_UM):
        progress(i / len(THICKNESSES_UM))
        unit = TwinUnit.build(board_of(presses, thickness_um), twin=Lamps.unpack(START).settings(mean_level))
        found = scenes(presses, unit)
        tried.append((*fit_lamps(presses, found[::2]), unit, found))
    cost, lamps, unit, found = min(tried, key=lambda fit: fit[0])
    lit = TwinUnit(unit.board, lamps.settings(mean_level), unit.model, unit.compliance)
    held_out = found[1::2]
    rendered = rendered_change(lit, held_out)
    rows = judge(presses, held_out, rendered)
    result: dict[str, Any] = {
        "fitted_on": len(found[::2]), "judged_on": len(held_out), "rings": rows,
        "thickness_mm": unit.model.thickness_m * 1e3, "lamps_mm": lamps.place_mm.round(2).tolist(),
        "power": lamps.power.round(3).tolist(), "ambient": lamps.ambient, "crosstalk": lamps.crosstalk, "cost": cost,
    }  # fmt: skip
    text = table(rows) + f"thickness that fits best: {result['thickness_mm']:g} mm"
    if out is not None:
        result["picture"] = str(side_by_side(out, presses, held_out, rendered))
        text += f"\n{out}"
    return result, text
