"""Place and force of the electroluminescent skin's method, and the loss of the skin's loops.

f and d come from 15 points on the tube's inner wall whose pixels a person read to a pixel; places are judged against
what a person measured. Force: the curve from the frames of indenters 2 to 4 at all ten points up to the paper's largest
force, judged at points 3 to 9 where the load cell passes 3, 5 and 9 N, on averages over the last 10, 5, 3 and 1 frames
of estimate and load cell alike. Beyond that force the mask carries, and brightness says nothing more.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from papers.eltac.method import Camera, Cylinder, brightest, brightness, force_curve
from papers.recorded import Recorded
from ruffini.boards import Board
from ruffini.sim.optics.camera import View
from ruffini.sim.optics.settings import ViewSettings
from ruffini.sim.settings import load_twin

Array = npt.NDArray[np.float64]

TUBE_MM, INNER_WALL_MM = 40.0, 38.0
N_KNOWN_POINTS = 15
READING_PX = 1.0  # with which a person reads a pixel
TARGETS_N = (3.0, 5.0, 9.0)
LARGEST_N = 9.4  # "normal forces from 3.1N to 9.4N"
REPEATED_N = 5.0
EDGE_POINTS = (0, 1, 9)  # 1, 2 and 10 are not in the paper's table
AVERAGES = {10: "ten frames", 5: "five frames", 3: "three frames", 1: "one frame"}


def judge(board: Board, runs: list[Recorded]) -> dict[str, float]:
    """Localisation (mm), force error, spread of five trials and hysteresis loss (%)."""
    camera, cylinder = _calibrated(board)
    figures: dict[str, float] = {}
    errors: dict[str, list[float]] = {}
    for recorded in runs:
        if recorded.set_name.startswith("locate_"):
            u, v, _ = brightest(_last(recorded))
            found = cylinder.place(*camera.polar(u, v))
            errors.setdefault(recorded.set_name[-1], []).append(float(np.linalg.norm(found - _noted(recorded))))
    figures["localisation"] = float(np.mean([e for each in errors.values() for e in each]))
    figures |= {f"localisation, indenter {n}": float(np.mean(each)) for n, each in sorted(errors.items())}
    pairs = np.concatenate([_curve(r) for r in runs if r.set_name == "curve"])
    pairs = pairs[pairs[:, 1] <= LARGEST_N]
    curve = force_curve(pairs[:, 0], pairs[:, 1])
    points = [_curve(r) for r in runs if r.set_name == "force" and int(r.run.key[-4:]) not in EDGE_POINTS]
    for n, name in AVERAGES.items():
        figures[f"force, {name}"] = float(np.mean([e for rows in points for e in _force_errors(rows, curve, n)]))
    trials = [_brightness_at(_curve(r), REPEATED_N) for r in runs if r.set_name == "repeat"]
    if len(trials) > 1:
        figures["repeatability, five trials"] = 100 * float(np.std(trials, ddof=1) / np.mean(trials))
    for recorded in runs:
        if recorded.set_name == "loops":
            speed = float(str(recorded.run.chosen["speed_um_s"])) * 1e-3
            figures[f"hysteresis at {speed:g} mm/s"] = _loss(recorded)
    return figures


def _calibrated(board: Board) -> tuple[Camera, Cylinder]:
    """The camera as it was calibrated, and eq. (3) fitted to points on the inner wall."""
    twin, camera, rng = load_twin(board), board.camera, np.random.default_rng(15)
    assert twin.lens is not None
    f = camera.focal_mpx * 1e-3
    k1, k2 = (c * 1e-6 for c in twin.lens.coefficients_1e6[:2])
    model = Camera(f, f, camera.center_x_mpx * 1e-3, camera.center_y_mpx * 1e-3, k1, k2)
    half = board.pad.size_y_um * 5e-4
    z, angle = rng.uniform(-0.8 * half, 0.8 * half, N_KNOWN_POINTS), rng.uniform(-np.pi, np.pi, N_KNOWN_POINTS)
    points = np.column_stack([INNER_WALL_MM * np.cos(angle), INNER_WALL_MM * np.sin(angle), z])
    true_px, _ = View(board, ViewSettings(), twin.lens).project(points)
    seen = true_px + rng.normal(size=true_px.shape) * READING_PX
    radii = np.array([model.polar(float(px[0]), float(px[1]))[0] for px in seen])
    return model, Cylinder.fit(radii, z, TUBE_MM)


def _last(recorded: Recorded) -> Array:
    return brightness(recorded.picture(int(recorded.touched[-1])), recorded.rest())


def _noted(recorded: Recorded) -> Array:
    """Where the person says that the contact was, on the tube of eq. (1), (3,) mm."""
    a, b = recorded.rig["place_m"] * 1e3
    return np.array([TUBE_MM * np.cos(a / TUBE_MM), TUBE_MM * np.sin(a / TUBE_MM), b])


def _inward_n(recorded: Recorded) -> Array:
    """What the load cell reads along the indenter's axis in every frame, N."""
    angle = float(recorded.truth["pose"][int(recorded.touched[-1]), 0]) * 1e3 / TUBE_MM
    force = recorded.rig["force"]
    return np.asarray(-(force[:, 0] * np.cos(angle) + force[:, 1] * np.sin(angle)))


def _curve(recorded: Recorded) -> Array:
    """Brightness and force (N) of every touched frame, (n, 2)."""
    rest, force = recorded.rest(), _inward_n(recorded)
    return np.array([(brightest(brightness(recorded.picture(int(i)), rest))[2], force[i]) for i in recorded.touched])


def _force_errors(pairs: Array, curve: Array, n: int) -> list[float]:
    """Relative error (%) at each target that a press reaches, of its brightness and force frame by frame."""
    errors = []
    for target in TARGETS_N:
        reached = np.flatnonzero(pairs[:, 1] >= target)
        if reached.size:
            rows = pairs[max(0, int(reached[0]) - n + 1) : int(reached[0]) + 1]
            measured = float(rows[:, 1].mean())
            errors.append(100 * abs(measured - float(np.polyval(curve, rows[:, 0]).mean())) / measured)
    return errors


def _brightness_at(pairs: Array, force_n: float) -> float:
    """Brightness where a press first reaches a force."""
    return float(np.interp(force_n, np.maximum.accumulate(pairs[:, 1]), pairs[:, 0]))


def _loss(recorded: Recorded) -> float:
    """Energy that a loop loses, of what was put in, %."""
    force, depth = _inward_n(recorded)[recorded.touched], recorded.truth["pose"][recorded.touched, 2]
    turn = int(np.argmax(depth)) + 1
    put_in = float(np.trapezoid(np.append(0, force[:turn]), np.append(0, depth[:turn])))
    got_back = -float(np.trapezoid(force[turn - 1 :], depth[turn - 1 :]))
    return 100 * (1 - got_back / put_in)
