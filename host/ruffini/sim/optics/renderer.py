"""The picture of a deformed surface: views, light, pattern, sensor, one after the other.

Geometry (firmware/DESIGN.md): the camera is at z = -H on the axis, x right, y down, looking along +z.
Shading is Lambertian with the normals of the deformed surface; light falls with distance squared.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.sim.optics.camera import View
from ruffini.sim.optics.charts import Floats, by_component, chart_of, dot
from ruffini.sim.optics.conditions import Conditions, TrayPose
from ruffini.sim.optics.lights import rgb_leds, white_ring
from ruffini.sim.optics.lights.electroluminescent import Openings
from ruffini.sim.optics.patterns import discs, dots
from ruffini.sim.optics.patterns.glitter import Glitter
from ruffini.sim.optics.patterns.lattice import Lattice
from ruffini.sim.optics.sensor import ImageSensor, dust_map
from ruffini.sim.optics.settings import (
    Electroluminescent,
    RgbLeds,
    SensorSettings,
    ViewSettings,
    WearSettings,
    WhiteRing,
)
from ruffini.sim.optics.surface import DeformedSurface, Hits, Surface
from ruffini.sim.optics.wall import TubeWall
from ruffini.sim.settings import TwinSettings

Array = npt.NDArray[np.float64]
FINE_PER_PX = 4 / 3  # lines of the surface's fine grid for each pixel
BLUR_STEPS = 4  # pictures that make a motion-blurred one
ROOM_LEVEL = 1.6  # of a room seen through a torn coating, over the mean level


@dataclass
class Seen:
    """One view with what stays the same from frame to frame."""

    view: View
    origin: Floats
    direction: Floats
    vignette: Floats
    rest: Hits
    openings: Openings | None = None


@dataclass
class Renderer:
    """Pictures of one simulated unit. Reusable for any displacement of the same surface.

    node_a_mm, node_b_mm : material coordinates of the nodes that carry displacements.
    """

    board: Board
    twin: TwinSettings
    node_a_mm: Array
    node_b_mm: Array
    has_dots: bool = True
    views: list[Seen] = field(init=False)
    # The last light and its reasons, of lit frames and of unlit ones.
    _last: dict[bool, tuple[tuple[object, ...], Floats]] = field(init=False, default_factory=dict)
    _deformed: tuple[bytes, DeformedSurface] | None = field(init=False, default=None)

    @classmethod
    def over_chart(cls, board: Board, twin: TwinSettings, n_nodes: int = 49) -> Renderer:
        """A renderer with n x n nodes over the whole surface, for bodies of any mechanics or of none."""
        half_a, half_b = chart_of(twin.shape).half_size(board.pad)
        return cls(board, twin, np.linspace(-half_a, half_a, n_nodes), np.linspace(-half_b, half_b, n_nodes))

    def at_rest(self) -> Array:
        """Displacement of the untouched surface, (n_b, n_a, 3)."""
        return np.zeros((*self.surface.shape, 3))

    def __post_init__(self) -> None:
        camera, twin = self.board.camera, self.twin
        step_mm = camera.standoff_um / camera.focal_mpx / FINE_PER_PX
        self.surface = Surface(chart_of(twin.shape), self.node_a_mm, self.node_b_mm, step_mm)
        unit = twin.unit
        self._lattice = None
        if self.board.markers is not None:
            self._lattice = Lattice(self.board.markers, self.board.pad, unit.lattice_shift_um, unit.lattice_turn_mrad)
        self._glitter = Glitter(twin.glitter, self.surface, unit.seed) if twin.glitter else None
        self._feet = discs.pin_feet(twin.pins) if twin.pins else None
        self._sensor = ImageSensor(twin.noise, twin.sensor or SensorSettings())
        self._wear = twin.wear or WearSettings()
        self._dust = dust_map(self._wear, (camera.height_px, camera.width_px), unit.seed)[..., None]
        light = twin.light
        self._lamps = np.zeros((1, 3), dtype=np.float32)  # an electroluminescent sheet is everywhere
        if not isinstance(light, Electroluminescent):
            self._lamps = rgb_leds.places(light) if isinstance(light, RgbLeds) else white_ring.places(light)
        # The lamps, then the parts of them that warm up; a lamp's own place keeps what its parts do not take.
        self._n_lamps = len(self._lamps)
        parts = twin.warming or []
        self._lamp_of = np.array([*range(self._n_lamps), *(part.lamp for part in parts)])
        shares = np.bincount([p.lamp for p in parts], [p.share_1e3 * 1e-3 for p in parts], self._n_lamps)
        self._share = np.array([*(1 - shares), *(part.share_1e3 * 1e-3 for part in parts)])
        own = self._lamps[self._lamp_of[self._n_lamps :]]
        places = [o if p.place_um is None else np.array(p.place_um) * 1e-3 for o, p in zip(own, parts, strict=True)]
        self._lamps = np.concatenate([self._lamps, np.array(places).reshape(-1, 3)]).astype(np.float32)
        rest = self.surface.deform(self.at_rest())
        self.views = self._make_views(rest)
        self._gain, self._ambient = self._normalise(rest)

    def _make_views(self, rest: DeformedSurface) -> list[Seen]:
        twin, views = self.twin, []
        wanted = twin.view or [ViewSettings()]
        index = twin.gel.index_1e3 * 1e-3 if twin.gel else 1.0
        for settings in wanted:
            view = View(self.board, settings, twin.lens, len(wanted), index, self._wall())
            origin, direction = (by_component(r.astype(np.float32)) for r in view.rays())
            v, u = np.mgrid[: view.height_px, : view.width_px]
            radius2 = (u - view.width_px / 2 + 0.5) ** 2 + (v - view.height_px / 2 + 0.5) ** 2
            vignette = 1 - twin.light.vignette_1e3 * 1e-3 * radius2 / radius2.max()
            hits = rest.hit(origin, direction)
            seen = Seen(view, origin, direction, vignette[..., None].astype(np.float32), hits)
            if isinstance(twin.light, Electroluminescent) and self._lattice is not None:
                seen.openings = Openings(twin.light, self._lattice, hits)
            views.append(seen)
        return views

    def _wall(self) -> TubeWall | None:
        light, shape = self.twin.light, self.twin.shape
        if not isinstance(light, Electroluminescent) or not light.window_um:
            return None
        return TubeWall(shape.radius_um * 1e-3, light.window_um * 1e-3, light.window_index_1e3 * 1e-3)

    def _normalise(self, rest: DeformedSurface) -> tuple[float, float]:
        """Gain that gives the untouched surface its mean level, and the diffuse light before that gain."""
        light = self.twin.light
        gains = self._share.astype(np.float32)
        mean, diffuse, weight = 0.0, 0.0, 0.0
        for seen in self.views:
            hits = seen.rest
            lit = seen.openings.cover if seen.openings else self._lit(hits)
            direct = self._direct(seen, rest, hits, gains, self._lamps).mean(axis=-1)
            vignette = seen.vignette[..., 0]
            mean += float(((direct if seen.openings else direct * lit) * vignette).sum())
            diffuse += float((lit * vignette).sum())
            weight += float(lit.sum())
        mean, diffuse = mean / weight, diffuse / weight
        ambient = light.ambient_1e3 * 1e-3 * mean
        return light.mean_level / (mean + ambient * diffuse), ambient

    def image(
        self,
        displacement_m: Array,
        rng: np.random.Generator,
        *,
        previous_m: Array | None = None,
        time_s: float = 0.0,
        conditions: Conditions | None = None,
        tray: TrayPose | None = None,
    ) -> npt.NDArray[np.uint8]:
        """One frame, (h, w, 3) uint8 B G R, of a surface displacement (n_nodes, 3) in metres.

        previous_m : displacement in the frame before, for motion blur where the twin has a shutter time.
        """
        conditions = conditions or Conditions()
        shutter = self._sensor.settings.shutter_1e3 * 1e-3
        if shutter and previous_m is not None:
            parts = 1 - shutter * (np.arange(BLUR_STEPS) + 0.5) / BLUR_STEPS
            states = [previous_m + part * (displacement_m - previous_m) for part in parts]
        else:
            states = [displacement_m]
        light = self._light(states[0], time_s, conditions, tray)
        if len(states) > 1:
            light = sum((self._light(state, time_s, conditions, tray) for state in states[1:]), light)
            light = light / np.float32(len(states))
        light = np.ascontiguousarray(light * self._dust * np.float32(conditions.exposure), dtype=np.float32)
        return self._sensor.expose(np.zeros_like(light) if conditions.is_capped else light, rng)

    def depth_mm(self, displacement_m: Array) -> Array:
        """u_z along each pixel's ray, (h, w), millimetres: what a perfect depth stage would say."""
        deformed = self.surface.deform(displacement_m)
        parts = [deformed.hit(seen.origin, seen.direction).displacement[..., 2] for seen in self.views]
        return np.concatenate(parts, axis=1).astype(float)

    def _light(self, displacement_m: Array, time_s: float, conditions: Conditions, tray: TrayPose | None) -> Floats:
        """Light of all views; the last one is kept, since often nothing moves from frame to frame."""
        is_drifting = self._wear.led_drift_1e3 > 0 or bool(self.twin.warming)
        moved = displacement_m.tobytes()
        told = (moved, time_s if is_drifting else 0.0, conditions, tray)
        last = self._last.get(conditions.is_unlit)
        if last is None or last[0] != told:
            if self._deformed is None or self._deformed[0] != moved:
                self._deformed = (moved, self.surface.deform(displacement_m))
            deformed = self._deformed[1]
            parts = [self._view(seen, deformed, time_s, conditions, tray) for seen in self.views]
            last = self._last[conditions.is_unlit] = (told, np.concatenate(parts, axis=1))
        return last[1]

    def _view(
        self, seen: Seen, deformed: DeformedSurface, time_s: float, conditions: Conditions, tray: TrayPose | None
    ) -> Floats:
        """Light of one view in grey levels, (h, w, 3)."""
        origin, direction, lamps = seen.origin, seen.direction, self._lamps
        if tray is not None:  # everything as the tray sees it
            turn = tray.matrix().astype(np.float32)
            shift_mm = np.array(tray.shift_m, dtype=np.float32) * np.float32(1e3)
            origin, direction, lamps = (origin - shift_mm) @ turn, direction @ turn, (lamps - shift_mm) @ turn
        # Openings do not move: the mask is bonded to the window.
        hits = seen.rest if seen.openings else deformed.hit(origin, direction)
        if conditions.is_unlit:
            return self._spoilt(np.zeros((*hits.a.shape, 3), np.float32), hits, conditions)
        gains = self._lamp_gain(time_s, conditions)
        light = self._direct(seen, deformed, hits, gains, lamps)
        light += np.float32(self._ambient)
        light *= seen.vignette * np.float32(self._gain)
        if seen.openings is None:
            light *= self._lit(hits)[..., None]
        light = self._patterned(light, deformed, hits, direction, lamps)
        self._draw_discs(light, seen.view, deformed, tray, float(gains.sum() / self._n_lamps))
        return self._spoilt(light, hits, conditions)

    def _direct(self, seen: Seen, deformed: DeformedSurface, hits: Hits, gains: Floats, lamps: Floats) -> Floats:
        light = self.twin.light
        if seen.openings is not None:
            return seen.openings.shade(deformed, gains.sum(keepdims=True))
        if isinstance(light, RgbLeds):
            return rgb_leds.shade(light, hits, gains, lamps, self._lamp_of)
        assert isinstance(light, WhiteRing)
        return white_ring.shade(light, hits, gains, lamps)

    def _lit(self, hits: Hits) -> Floats:
        """1 where a pixel sees the surface, else 0; a plane pad goes on as its border does."""
        is_lit = hits.is_inside | (self.twin.shape.kind == "plane")
        return is_lit.astype(np.float32)

    def _lamp_gain(self, time_s: float, conditions: Conditions) -> Floats:
        n = self._n_lamps
        phase = np.random.default_rng([self.twin.unit.seed, 2]).uniform(0, 2 * np.pi, n)
        drift = self._wear.led_drift_1e3 * 1e-3
        gain = 1 + drift * (np.sin(2 * np.pi * time_s / self._wear.led_drift_s + phase) - np.sin(phase))
        gain[[i for i in (*self._wear.dead_leds, *conditions.lamps_off) if i < n]] = 0
        warming = self.twin.warming or []
        loss = np.array([0.0] * n + [part.loss_1e3 * 1e-3 for part in warming])
        constant_s = np.array([1] * n + [part.time_s for part in warming])
        gain = gain[self._lamp_of] * self._share * (1 - loss * (1 - np.exp(-time_s / constant_s)))
        return np.asarray(gain, dtype=np.float32)

    def _patterned(
        self, light: Floats, deformed: DeformedSurface, hits: Hits, direction: Floats, lamps: Floats
    ) -> Floats:
        if self.twin.dots is not None and self.has_dots and self._lattice is not None and self.board.markers:
            diameter_um = self.board.markers.diameter_um
            light = light * dots.transmission(self.twin.dots, self._lattice, diameter_um, hits)[..., None]
        if self._glitter is not None:
            to_camera = -direction / np.sqrt(dot(direction, direction))[..., None]
            to_lamps = lamps[: self._n_lamps].mean(axis=0) - hits.point
            half_way = to_camera + to_lamps / np.sqrt(dot(to_lamps, to_lamps))[..., None]
            half_way /= np.sqrt(dot(half_way, half_way))[..., None]
            light = self._glitter.add(light, deformed, hits, half_way)
        return light

    def _draw_discs(
        self, light: Floats, view: View, deformed: DeformedSurface, tray: TrayPose | None, lamps: float
    ) -> None:
        pins, targets = self.twin.pins, self.twin.targets
        if pins is not None and self._feet is not None:
            discs.draw(
                light, view, discs.pin_tips(pins, deformed, self._feet), pins.radius_um * 1e-3, lamps * pins.level
            )
        if targets is not None:
            places = np.array(targets.places_um) * 1e-3
            if tray is not None:
                places = places @ tray.matrix().T + np.array(tray.shift_m) * 1e3
            discs.draw(light, view, places, targets.radius_um * 1e-3, lamps * targets.level)

    def _spoilt(self, light: Floats, hits: Hits, conditions: Conditions) -> Floats:
        level = np.float32(self.twin.light.mean_level)
        if conditions.tear_um is not None:
            x, y, radius = (value * 1e-3 for value in conditions.tear_um)
            light[np.hypot(hits.a - x, hits.b - y) < radius] = ROOM_LEVEL * level
        if conditions.leak:
            fade = np.exp(-np.arange(light.shape[1], dtype=np.float32) / (light.shape[1] / 3))
            light = light + level * np.float32(conditions.leak) * fade[:, None]
        return light
