"""What a world must be like before it is simulated: one sentence with the remedy for each that is not."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError
from ruffini.robot.attached import AttachedPad
from ruffini.robot.shapes import mesh_vertices

Array = npt.NDArray[np.float64]

LARGEST_MEAN_M = 1.0  # of bodies that a gripper handles; a cup of 80 mm in millimetres is 80
STABLE = 1.0  # step times angular frequency; a symplectic step without damping ends at 2
FACETS = 0.25  # of the pad's shorter side: longer edges of a mesh that is to be round are flats to the pad
ROUND_RAD = (0.14, 0.8)  # angles between neighbouring facets of a surface that is to be round


def check(model: Any, data: Any, pads: Sequence[AttachedPad]) -> None:
    """Refuse what cannot be simulated; `data` is where it starts, with its kinematics computed.

    Raises
    ------
    InputError
        The model is in millimetres, its integrator or its step does not do, a mesh is too coarse for the pad, or a
        pad is inside an object.
    """
    if model.stat.meansize > LARGEST_MEAN_M:
        raise InputError(
            f"the model's bodies are {model.stat.meansize:.0f} m large on average: MuJoCo counts in metres, so scale "
            'a model in millimetres by 0.001 (meshes: <mesh scale="0.001 0.001 0.001"/>)'
        )
    if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        raise InputError('the integrator RK4 cannot take a pad\'s forces: set <option integrator="implicitfast"/>')
    for pad in pads:
        _check_step(model, pad, len(pads))
        for geom in pad.geoms:
            _check_facets(model, geom, pad)
        _check_start(model, data, pad)


def _check_step(model: Any, pad: AttachedPad, n_pads: int) -> None:
    lightest = max((float(model.body_invweight0[body, 0]) for body in pad.bodies), default=0.0)
    inverse_mass = float(model.body_invweight0[pad.body, 0]) + lightest
    frequency = np.sqrt(min(n_pads, 2) * pad.solid.stiffness_n_per_m * inverse_mass)
    if model.opt.timestep * frequency > STABLE:
        raise InputError(
            f"a step of {1e3 * model.opt.timestep:g} ms is too long for pad {pad.name!r}, which pressed all over is a "
            f"spring of {1e-3 * pad.solid.stiffness_n_per_m:.0f} N/mm: set <option timestep="
            f'"{_rounded_down(STABLE / frequency):g}"/> or make the lightest body that it touches heavier'
        )


def _rounded_down(step_s: float) -> float:
    """To one digit."""
    digit = 10.0 ** np.floor(np.log10(step_s))
    return float(np.floor(step_s / digit) * digit)


def _check_facets(model: Any, geom: int, pad: AttachedPad) -> None:
    if model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_MESH:
        return
    from scipy.spatial import ConvexHull

    hull = ConvexHull(mesh_vertices(model, model.geom_dataid[geom]))
    normal, limit = hull.equations[:, :3], FACETS * 2 * min(pad.solid.half_size_m)
    longest = 0.0
    for i, neighbours in enumerate(hull.neighbors):
        for k, j in enumerate(neighbours):
            if ROUND_RAD[0] < np.arccos(np.clip(normal[i] @ normal[j], -1, 1)) < ROUND_RAD[1]:
                edge = np.delete(hull.simplices[i], k)
                longest = max(longest, float(np.linalg.norm(np.subtract(*hull.points[edge]))))
    if longest > limit:
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_MESH, model.geom_dataid[geom])
        raise InputError(
            f"mesh {name!r} is too coarse for pad {pad.name!r}: its round side has edges of {1e3 * longest:.1f} mm, "
            f"which the pad feels as flats; at most {1e3 * limit:.1f} mm, so export it finer or use a primitive shape"
        )


def _check_start(model: Any, data: Any, pad: AttachedPad) -> None:
    deepest = pad.solid.unit.model.thickness_m / 2
    for other, _, depth in pad.depths(data, pad.frame(data)):
        if depth.max() > deepest:
            body = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, other.body) or f"body {other.body}"
            raise InputError(
                f"pad {pad.name!r} starts {1e3 * min(float(depth.max()), 1.0):.1f} mm inside {body!r}: it can be "
                f"pressed {1e3 * deepest:.1f} mm, so move one of them away, or open the gripper in the start pose"
            )
