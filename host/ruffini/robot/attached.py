"""A pad that a MuJoCo model carries: what of the world touches it, and the forces between them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError
from ruffini.robot.mechanics import PadContact, PadSolid, wrench_about
from ruffini.robot.shapes import Hull, entry

Array = npt.NDArray[np.float64]

DAMPING_S = 1e-3  # Kelvin-Voigt: what a gel takes up in a millisecond; its slower relaxation is left out
NEAR_M = 1e-3  # above the face, from where a geom is followed
KINDS = {
    mujoco.mjtGeom.mjGEOM_PLANE: "plane",
    mujoco.mjtGeom.mjGEOM_SPHERE: "sphere",
    mujoco.mjtGeom.mjGEOM_CAPSULE: "capsule",
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: "ellipsoid",
    mujoco.mjtGeom.mjGEOM_CYLINDER: "cylinder",
    mujoco.mjtGeom.mjGEOM_BOX: "box",
    mujoco.mjtGeom.mjGEOM_MESH: "mesh",
}


@dataclass(frozen=True)
class Frame:
    """Where something is in the world: `rotation` (3, 3) from its axes, `origin` (3,) metres."""

    rotation: Array
    origin: Array

    def of(self, other: Frame) -> Frame:
        """The other's frame as this one sees it."""
        return Frame(self.rotation.T @ other.rotation, self.rotation.T @ (other.origin - self.origin))


@dataclass
class _Touching:
    """A geom of the world as the pad sees it."""

    geom: int
    body: int
    kind: str
    size: Array
    hull: Hull | None
    friction: float
    reach_m: float
    pad_share: float  # of the depth; the rest is the geom's
    before: Frame | None = None  # in the last step, in the pad's frame


_Near = tuple[_Touching, Frame, Array]


@dataclass
class AttachedPad:
    """A pad at a site or a geom of a model; `contact.force` is of its last step.

    Attributes
    ----------
    wrench : (6,) force (N) and moment (N m) ON the pad about its undeformed centre, in its frame.
    moduli_pa : of soft geoms, by name. Under each node such a geom gives as a layer as thick as the pad does, in the
        ratio of the moduli.
    deepest_m : how far the world is below the undeformed face at most.
    """

    name: str
    solid: PadSolid
    model: Any
    body: int
    place: Frame  # in the body
    moduli_pa: Mapping[str, float] = field(default_factory=dict)
    contact: PadContact = field(init=False)
    wrench: Array = field(init=False, default_factory=lambda: np.zeros(6))
    deepest_m: float = field(init=False, default=0.0)
    _others: list[_Touching] = field(init=False)
    _last: Array = field(init=False)  # depth in the last step, (n,)

    def __post_init__(self) -> None:
        self.contact = PadContact(self.solid)
        self._points = np.column_stack([self.solid.place, np.zeros(len(self.solid.place))])
        self._others = [self._seen(geom) for geom in range(self.model.ngeom) if self._may_touch(geom)]
        self._reach_m = float(np.hypot(*self.solid.half_size_m))
        self.reset()

    def reset(self) -> None:
        """Nothing has touched it."""
        self.contact.release()
        self.wrench, self.deepest_m = np.zeros(6), 0.0
        self._last = np.full(len(self._points), -np.inf)
        for other in self._others:
            other.before = None

    def _may_touch(self, geom: int) -> bool:
        model, body = self.model, self.model.geom_bodyid[geom]
        collides = model.geom_contype[geom] or model.geom_conaffinity[geom]
        return bool(collides and model.body_weldid[body] != model.body_weldid[self.body])

    def _seen(self, geom: int) -> _Touching:
        model, kind = self.model, KINDS.get(mujoco.mjtGeom(self.model.geom_type[geom]))
        if kind is None:
            raise InputError(
                f"pad {self.name!r} cannot touch {_name_of(model, geom)}, a height field or signed distance field: "
                "make it a mesh or a primitive shape, or let it touch nothing (contype and conaffinity 0)"
            )
        size = model.geom_size[geom].copy()
        hull = None
        if kind == "box":
            hull = Hull(np.vstack([np.eye(3), -np.eye(3)]), np.concatenate([size, size]))
        elif kind == "plane":
            hull = Hull(np.array([[0.0, 0.0, 1.0]]), np.zeros(1))
        elif kind == "mesh":
            hull = Hull.of_mesh(model, model.geom_dataid[geom])
        reach = 0.0 if kind == "plane" else float(model.geom_rbound[geom])
        friction = float(model.geom_friction[geom, 0])
        modulus = self.moduli_pa.get(mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_GEOM, geom) or "", math.inf)
        share = 1 / (1 + self.solid.unit.model.modulus_pa / modulus)
        return _Touching(geom, int(model.geom_bodyid[geom]), kind, size, hull, friction, reach, share)

    @property
    def geoms(self) -> list[int]:
        """Geoms that may touch it."""
        return [other.geom for other in self._others]

    @property
    def bodies(self) -> list[int]:
        """Bodies that may touch it."""
        return sorted({other.body for other in self._others})

    def frame(self, data: Any) -> Frame:
        """Where the pad is."""
        rotation = data.xmat[self.body].reshape(3, 3)
        return Frame(rotation @ self.place.rotation, data.xpos[self.body] + rotation @ self.place.origin)

    def depths(self, data: Any, pad: Frame) -> list[_Near]:
        """Geoms near the pad, where they are in its frame, and how far below its face at each node, (n,)."""
        out = []
        for other in self._others:
            if _away_m(data, other, pad) > other.reach_m + self._reach_m + NEAR_M:
                other.before = None
                continue
            seen = pad.of(Frame(data.geom_xmat[other.geom].reshape(3, 3), data.geom_xpos[other.geom]))
            start = (self._points - seen.origin) @ seen.rotation
            out.append((other, seen, -entry(other.kind, other.size, start, seen.rotation[2], other.hull)))
        return out

    def advance(self, data: Any, step_s: float, applied: Array) -> None:
        """One step; adds forces and torques about the centres of mass to `applied` (bodies, 6), world axes."""
        n = len(self._points)
        depth, motion, friction = np.full(n, -np.inf), np.zeros((n, 2)), np.zeros(n)
        owner = np.full(n, -1)
        pad = self.frame(data)
        near = self.depths(data, pad)
        for i, (other, seen, own) in enumerate(near):
            nearest = own > depth
            depth[nearest], owner[nearest], friction[nearest] = own[nearest], i, other.friction
            if other.before is not None and (touched := nearest & (own > 0)).any():
                now = self._points[touched]
                was = (now - seen.origin) @ seen.rotation @ other.before.rotation.T + other.before.origin
                motion[touched] = (now - was)[:, :2]
            other.before = seen
        self.deepest_m = float(depth.max(initial=-np.inf))
        if any(other.pad_share < 1 for other, _, _ in near):
            share = np.array([other.pad_share for other, _, _ in near])[owner]
            depth, motion = depth * share, motion * share[:, None]
        if self.deepest_m <= 0:
            if self.wrench.any():
                self.contact.release()
                self.wrench = np.zeros(6)
            self._last = depth
            return
        depth = np.minimum(depth, self.solid.unit.model.thickness_m / 2)
        lead = np.zeros((n, 3))
        lead[:, :2] = motion
        follows = np.isfinite(self._last) & (depth > 0)
        lead[follows, 2] = depth[follows] - self._last[follows]
        lead *= DAMPING_S / step_s
        self._last = depth
        self.contact.advance(depth, motion, friction, lead)
        self._apply(data, pad, near, owner, applied)

    def _apply(self, data: Any, pad: Frame, near: list[_Near], owner: npt.NDArray[np.intp], applied: Array) -> None:
        self.wrench = np.zeros(6)
        force = self.contact.force
        for i, (other, _, _) in enumerate(near):
            part = wrench_about(self.solid.place, force if len(near) == 1 else force * (owner == i)[:, None])
            self.wrench += part
            push, turn = pad.rotation @ part[:3], pad.rotation @ part[3:]
            for body, sign in ((self.body, 1.0), (other.body, -1.0)):
                arm = (pad.origin - data.xipos[body]).tolist()
                applied[body, :3] += sign * push
                applied[body, 3:] += sign * (turn + _cross(arm, push.tolist()))


def _away_m(data: Any, other: _Touching, pad: Frame) -> float:
    """Of a pad's middle from that of a geom, or from a plane."""
    origin = data.geom_xpos[other.geom]
    if other.kind != "plane":
        return math.dist(origin, pad.origin)
    return float((pad.origin - origin) @ data.geom_xmat[other.geom][2::3])


def _name_of(model: Any, geom: int) -> str:
    name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_GEOM, geom)
    return f"geom {name!r}" if name else f"geom {geom}"


def _cross(a: list[float], b: list[float]) -> list[float]:
    """Of two vectors: numpy's takes longer than the rest of a step."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
