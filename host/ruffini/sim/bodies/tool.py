"""A rigid tool against a surface with a soft skin: pressure by overlap, Coulomb friction by stick and slip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError
from ruffini.sim.indenters import Indenter
from ruffini.sim.prony import Memory, Prony

Array = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

SLOPE_STEP = 0.02  # of the tool's radius: edges are as round as that, so that the push turns steadily about them
MOST_SQUEEZED = 0.85  # of a skin


@dataclass(frozen=True)
class Grip:
    """Place of the tool's lowest point (3,) and its rotation (3, 3), from the tool's axes to the body's."""

    tip: Array
    rotation: Array
    reach_m: float

    def lifted(self, way_m: float) -> Grip:
        """The same, further out along its axis."""
        return Grip(self.tip + way_m * self.rotation[:, 2], self.rotation, self.reach_m)

    def way_to(self, end: Grip) -> float:
        """Longest way of a point of its face, about, metres; a way from above counts from where it begins."""
        turned = float(np.linalg.norm(end.rotation - self.rotation)) * self.reach_m
        return float(np.linalg.norm(end.tip - self.tip)) + turned

    def towards(self, end: Grip, part: float) -> Grip:
        """At `part` of the way: the tip in a straight line, the turn about one axis."""
        from scipy.spatial.transform import Rotation

        if part == 1:
            return end
        turn = Rotation.from_matrix(end.rotation @ self.rotation.T).as_rotvec()
        rotation = Rotation.from_rotvec(part * turn).as_matrix() @ self.rotation
        return Grip(self.tip + part * (end.tip - self.tip), np.asarray(rotation), self.reach_m)


class ToolContact:
    """One tool on one surface. Stiffnesses per area, Pa/m, of the skin against pressure and against shear.

    skin_m : thickness of the skin: with overlap o the pressure is k o / (1 - o / skin_m), in a straight line from
    MOST_SQUEEZED on. Infinite: it never gets stiffer. relaxation : of that pressure.
    """

    def __init__(
        self,
        indenter: Indenter,
        normal_pa_m: float,
        shear_pa_m: float,
        n_points: int,
        skin_m: float = np.inf,
        relaxation: Prony | None = None,
    ) -> None:
        if indenter.material is not None:
            raise InputError("only rigid tools can be pressed on this body: leave the hardness out")
        self.indenter, self._normal_pa_m, self._shear_pa_m = indenter, normal_pa_m, shear_pa_m
        self._skin_m, self._memory = skin_m, Memory(relaxation or Prony())
        self._elastic: Array = np.zeros(n_points)
        self.grip: Grip | None = None
        self._anchor: Array = np.full((n_points, 3), np.nan)  # in the tool's axes; NaN: has not touched yet
        self._now: tuple[Bools, Array, Bools] | None = None

    def move(self, grip: Grip) -> None:
        """The tool is there now."""
        self.grip = grip

    def deepest(self, grip: Grip, place: Array) -> float:
        """How far points (n, 3) reach into a tool at `grip`, along its axis; negative where it is clear of them."""
        point = (place - grip.tip) @ grip.rotation
        return float((point[:, 2] - self.indenter.height(point[:, 0], point[:, 1])).max())

    def _distance(self, point: Array) -> tuple[Array, Array]:
        """Overlap (n,) of points (n, 3) in the tool's axes, and the tool's outward normals (n, 3)."""
        step = SLOPE_STEP * self.indenter.radius_m
        x, y = point[:, 0], point[:, 1]
        height = self.indenter.height
        slope = np.stack([height(x + step, y) - height(x - step, y), height(x, y + step) - height(x, y - step)], axis=1)
        normal = np.column_stack([slope / (2 * step), -np.ones(len(x))])
        length = np.linalg.norm(normal, axis=1)
        return (point[:, 2] - height(x, y)) / length, normal / length[:, None]

    def _pressure(self, overlap: Array) -> tuple[Array, Array]:
        """Pressure, Pa, and its slope, Pa/m."""
        k, squeezed = self._normal_pa_m, np.minimum(overlap / self._skin_m, MOST_SQUEEZED)
        slope = k / (1 - squeezed) ** 2
        inside = np.minimum(overlap, MOST_SQUEEZED * self._skin_m)
        return k * inside / (1 - squeezed) + slope * (overlap - inside), slope

    def begin(self, duration_s: float) -> None:
        """A step of this duration."""
        self._memory.begin(duration_s)

    def press(self, place: Array, friction: float) -> tuple[Array, Array]:
        """Traction (n, 3) on points of the surface at `place`, and minus its derivative, (n, 3, 3); Pa, Pa/m."""
        assert self.grip is not None
        traction, stiffness = np.zeros_like(place), np.zeros((len(place), 3, 3))
        rotation = self.grip.rotation
        point = (place - self.grip.tip) @ rotation
        near = np.flatnonzero(point[:, 2] > 0)
        overlap, normal = self._distance(point[near])
        elastic, steep = self._pressure(np.maximum(overlap, 0.0))
        self._elastic = np.zeros(len(place))
        self._elastic[near] = elastic
        held = np.broadcast_to(self._memory.held, len(place))[near]
        pressure = self._memory.factor * elastic + held
        is_touched = (overlap > 0) & (pressure > 0)  # what was squeezed is slow to come back
        touched, normal, pressure = near[is_touched], normal[is_touched], pressure[is_touched]
        steep = self._memory.factor * steep[is_touched]
        local = pressure[:, None] * normal
        nn = normal[:, :, None] * normal[:, None, :]
        law = steep[:, None, None] * nn
        way = np.nan_to_num(point[touched] - self._anchor[touched])
        way -= (way * normal).sum(axis=1, keepdims=True) * normal
        shear, limit = self._shear_pa_m * np.linalg.norm(way, axis=1), friction * pressure
        slips = np.asarray(shear > limit)
        along = way / np.maximum(np.linalg.norm(way, axis=1), 1e-300)[:, None]
        local -= np.where(slips, limit, shear)[:, None] * along
        across = np.eye(3) - nn
        has = np.asarray(np.isfinite(self._anchor[touched, 0]))
        stick = self._shear_pa_m * across
        softer = (limit / np.maximum(np.linalg.norm(way, axis=1), 1e-300))[:, None, None]
        slip = softer * (across - along[:, :, None] * along[:, None, :])
        slip -= (friction * steep)[:, None, None] * along[:, :, None] * normal[:, None, :]
        law += np.where(slips[:, None, None], slip, np.where(has[:, None, None], stick, 0.0))
        traction[touched] = local @ rotation.T
        stiffness[touched] = rotation @ law @ rotation.T
        self._now = self._end(point, touched, way, along, slips, limit)
        return traction, stiffness

    def _end(
        self, point: Array, touched: npt.NDArray[np.intp], way: Array, along: Array, slips: Bools, limit: Array
    ) -> tuple[Bools, Array, Bools]:
        """Which points slip, where each sticks from now on, and which touch."""
        anchor, is_slipping, touches = (
            np.full_like(self._anchor, np.nan), np.zeros(len(point), bool), np.zeros(len(point), bool),
        )  # fmt: skip
        has = np.asarray(np.isfinite(self._anchor[touched, 0]))
        kept = np.where(slips[:, None], limit[:, None] / self._shear_pa_m * along, way)
        anchor[touched] = np.where(has[:, None], point[touched] - kept, point[touched])
        is_slipping[touched], touches[touched] = slips, True
        return is_slipping, anchor, touches

    def commit(self) -> Bools:
        """The last `press` was balance: points stick where they are now. Which ones slip, (n,)."""
        assert self._now is not None
        is_slipping, self._anchor, self.touches = self._now
        self._memory.commit(self._elastic)
        return is_slipping
