"""Checks of the solid: finite strain against closed forms and another solution, balance, relaxation."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from ruffini.sim.contact import CORRECTED_M, MAX_CORRECTIONS, ContactSolver, Indenter, Pose
from ruffini.sim.finite import FiniteMesh
from ruffini.sim.pad import PadModel, surface_compliance
from ruffini.sim.prony import Prony
from ruffini.sim.response import FiniteResponse, LinearResponse
from ruffini.sim.surface import hat_areas
from ruffini.sim.validation.block import Block
from ruffini.sim.validation.rows import Curve, Outcome, Row

Array = npt.NDArray[np.float64]
Progress = Callable[[float], None]

MM, MODULUS_PA = 1e-3, 2e5
SERIES = Prony(((0.1, 0.1), (0.08, 1.0), (0.07, 10.0)))  # a quarter in all


def balance(out: Outcome) -> None:
    """What presses on the surface arrives at the bed: force, and moment about where everything moved."""
    model = PadModel(8 * MM, 6 * MM, 3 * MM, MODULUS_PA, 0.48, 10, 8, layers=(0.2, 0.3, 0.5))
    response = FiniteResponse(FiniteMesh(model))
    solver = ContactSolver(model, response, Indenter("sphere", 3 * MM), 0.6)
    solver.advance(Pose(0.5 * MM, 0, 0.6 * MM))
    solver.advance(Pose(0.7 * MM, 0.1 * MM, 0.6 * MM))
    load, bed = solver.nodal_force, response.internal_force()[0]
    x, y = np.meshgrid(model.node_x(), model.node_y())
    flat = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    moment = np.cross(flat + response.surface, load).sum(axis=0)
    at_bed = np.cross(flat - (0, 0, model.thickness_m), bed).sum(axis=0)
    size, turning = float(np.linalg.norm(load.sum(axis=0))), float(np.linalg.norm(moment))
    name = "Balance, sheared ball, finite strain"
    for i, axis in enumerate("xyz"):
        out.rows.append(Row(name, f"force {axis} at the bed", -load[:, i].sum(), bed[:, i].sum(), "N", 1e-3, size))
    for i, axis in enumerate("xyz"):
        out.rows.append(
            Row(name, f"moment {axis} at the bed", -moment[i] / MM, at_bed[i] / MM, "N mm", 1e-3, turning / MM)
        )


def confined(out: Outcome) -> None:
    """A wide plate on a thin layer: no lateral strain in the middle, P = mu (l - 1/l) + lambda ln l / l."""
    thickness, poisson = 0.5 * MM, 0.3
    model = PadModel(16 * MM, 16 * MM, thickness, MODULUS_PA, poisson, 10, 10, layers=(0.5, 0.5))
    mesh = FiniteMesh(model)
    solver = ContactSolver(model, FiniteResponse(mesh), Indenter("square", 6.4 * MM), 1.0)
    middle, area = len(solver.hat_force) // 2, hat_areas(model)

    def theory(stretch: Array) -> Array:
        return np.asarray(-(mesh.shear * (stretch - 1 / stretch) + mesh.lame * np.log(stretch) / stretch) / 1e3)

    measured = []
    for part in (0.1, 0.2, 0.3):
        solver.advance(Pose(0, 0, part * thickness))
        measured.append((part, -solver.hat_force[middle, 2] / area[middle] / 1e3))
    name = "Bonded plate, 30 % compression"
    expected = float(theory(np.array(1 - measured[-1][0])))
    out.rows.append(Row(name, "pressure in the middle", expected, measured[-1][1], "kPa", 0.02))
    parts, points = np.linspace(0, 0.32, 30), np.array(measured).T
    out.curves.append(Curve("Bonded plate, finite strain", "compression", "kPa", (parts, theory(1 - parts)),
                            (points[0], points[1])))  # fmt: skip


def shear(out: Outcome) -> None:
    """Simple shear by 0.6: P = mu gamma, and no pressure."""
    model = PadModel(6 * MM, 6 * MM, 3 * MM, MODULUS_PA, 0.45, 4, 4, layers=(0.5, 0.5))
    mesh, gamma = FiniteMesh(model), 0.6
    u = mesh.at_rest()
    u[..., 0] = gamma * np.linspace(0, model.thickness_m, mesh.n_planes)[:, None]
    stress = mesh.internal_force(u)[-1].sum(axis=0) / (6 * MM) ** 2
    name = "Simple shear by 0.6"
    out.rows += [
        Row(name, "shear stress", mesh.shear * gamma / 1e3, stress[0] / 1e3, "kPa", 1e-6),
        Row(name, "normal stress", 0.0, stress[2] / 1e3, "kPa", 1e-6, mesh.shear / 1e3),
    ]


def another_solution(out: Outcome, *, n: int, tolerance: float) -> None:
    """A block under a dead patch of pressure, at finite strain, by other elements and Newton's method."""
    block, pressure = Block(4 * MM, 2 * MM, 2 * MM, MODULUS_PA, 0.3), 6e4
    model = PadModel(8 * MM, 8 * MM, 2 * MM, MODULUS_PA, 0.3, 12, 12, layers=(0.15, 0.2, 0.3, 0.35))
    force = patch_load(model, pressure)
    finite = loaded(FiniteResponse(FiniteMesh(model)), force)
    middle, name = len(force) // 2, "Block under a patch of 60 kPa"
    depth = block.centre_depth(pressure, n)
    out.rows.append(Row(name, "depth, 8-node bricks", depth / MM, -finite[middle, 2] / MM, "mm", tolerance))


def patch_load(model: PadModel, pressure_pa: float) -> Array:
    """Nodal forces (n, 3) of a pressure on the middle half of each side of a square pad of a multiple of 4 elements.

    A quadratic element shares it out as 1 : 4 : 1 along each side.
    """
    n = model.n_cells_x
    share = np.zeros(model.shape[0])
    for cell in range(n // 4, 3 * n // 4):
        share[2 * cell : 2 * cell + 3] += np.array([1, 4, 1]) / 6 * (model.size_x_m / n)
    force = np.zeros((model.shape[0] ** 2, 3))
    force[:, 2] = -pressure_pa * np.outer(share, share).ravel()
    return force


def loaded(response: FiniteResponse, force: Array, n_steps: int = 5) -> Array:
    """Displacement of a surface (n, 3) under dead forces (n, 3), in even steps."""
    for part in np.arange(1, n_steps + 1) / n_steps:
        response.begin(0.0)
        for _ in range(MAX_CORRECTIONS):
            response.free_surface()
            if response.correct(part * force, response.surface) < CORRECTED_M:
                break
        response.commit()
    return response.surface


def relaxation(out: Outcome) -> None:
    """A plate over the whole pad held for a minute, and in and out evenly within a second: F = k int g d(depth)."""
    model = PadModel(10 * MM, 10 * MM, 4 * MM, MODULUS_PA, 0.45, 8, 8, layers=(0.4, 0.6))
    compliance, depth = surface_compliance(model), 0.1 * MM

    def plate() -> ContactSolver:
        return ContactSolver(model, LinearResponse(compliance, SERIES), Indenter("square", 6 * MM), 0.0)

    def force(solver: ContactSolver) -> float:
        return -float(solver.nodal_force[:, 2].sum())

    held, steps = plate(), np.geomspace(0.02, 60, 12)
    held.advance(Pose(0, 0, depth))
    times, forces = [0.0], [force(held)]
    for end in steps:
        held.advance(Pose(0, 0, depth), float(end) - times[-1])
        times.append(float(end))
        forces.append(force(held))
    name = "Relaxation, plate"
    loss = 100 * (1 - SERIES.part(60.0) / SERIES.part(0.0))
    out.rows.append(Row(name, "loss in a minute", loss, 100 * (1 - forces[-1] / forces[0]), "%", 0.01))
    line = np.geomspace(0.01, 60, 60)
    out.curves.append(
        Curve(name, "time / s", "force over the first", (line, np.array([SERIES.part(float(t)) for t in line])
              / SERIES.part(0.0)), (np.array(times[1:]), np.array(forces[1:]) / forces[0]))
    )  # fmt: skip
    out.rows.append(Row(name, "loss in a loop of 1 s", *_loop(plate(), depth, force), "%", 0.03))


def _loop(
    solver: ContactSolver, depth: float, force: Callable[[ContactSolver], float], n: int = 40
) -> tuple[float, float]:
    """Per cent of the work that a loop of 1 s keeps: by the series, and by the twin."""
    way = np.concatenate([np.linspace(0, 1, n + 1), np.linspace(1, 0, n + 1)[1:]])
    dt = 0.5 / n
    kernel = [np.mean([SERIES.part(t) for t in np.linspace(i * dt, (i + 1) * dt, 9)]) for i in range(2 * n)]
    theory = [0.0] + [sum(kernel[i - 1 - k] * (way[k + 1] - way[k]) for k in range(i)) for i in range(1, 2 * n + 1)]
    twin = [0.0]
    for part in way[1:]:
        solver.advance(Pose(0, 0, float(part) * depth), dt)
        twin.append(force(solver))

    def lost(values: list[float]) -> float:
        f = np.maximum(np.array(values), 0.0)  # the plate does not pull
        work = np.diff(way) * (f[1:] + f[:-1]) / 2
        return float(100 * work.sum() / work[:n].sum())

    return lost(theory), lost(twin)


def run(out: Outcome, *, quick: bool, progress: Progress = lambda _: None) -> None:
    """All of them; quick ones compare with a coarser block."""
    relaxation(out)
    shear(out)
    progress(0.1)
    balance(out)
    progress(0.3)
    confined(out)
    progress(0.5)
    another_solution(out, n=4 if quick else 6, tolerance=0.03 if quick else 0.02)  # the coarser one is 2 % off itself
    progress(1.0)
