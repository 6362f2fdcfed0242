"""Lamps that drift, and a contact held under them. SIMULATED.

The twin's frames, times a gain per channel, go through the board's own front end and solve: once with the light changed
at a stroke between rest and press (nothing can be followed: "before"), once with the same change as a ramp on the
untouched pad ("after"). A contact is held for two minutes under steady light: nothing of it may be learned.
Lamps that warm up unevenly: `ruffini.bench.warming`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.bench import warming
from ruffini.bench.fitted import NOISE, colours_of
from ruffini.boards import Board
from ruffini.calibrate import container
from ruffini.core.pipeline import Frame, Pipeline
from ruffini.estimators.operator.fit import make_operator
from ruffini.sim.contact import Indenter, Pose
from ruffini.sim.settings import TwinSettings
from ruffini.sim.surface import wrench_of
from ruffini.sim.unit import TwinUnit
from ruffini.tables import aligned

Array = npt.NDArray[np.float64]
Progress = Callable[[float], None]

DRIFTS = (0.0, 0.02, 0.05, 0.10)
WAY = np.array([1.0, -0.6, 0.3])  # of B, G, R: lamps age apart
RAMP_FRAMES, SETTLE_FRAMES, HELD_FRAMES = 300, 100, 7_200  # held: two minutes at 60 Hz
PRESS_MM, BALL_MM = 0.6, 4.0
SEED = 20_261_131


class Scene:
    """Frames of one unit, untouched and pressed, under any light."""

    def __init__(self, board: Board) -> None:
        self.unit = TwinUnit.build(board)
        self.rng = np.random.default_rng(SEED)
        self._renderer = self.unit.renderer()
        self.pressed, self.force_n = self.press(Pose(1e-3, -1e-3, PRESS_MM * 1e-3))

    def press(self, pose: Pose) -> tuple[Array, float]:
        """Displacement and true normal force of the ball at a pose."""
        solver = self.unit.solver(Indenter("sphere", BALL_MM * 1e-3))
        solver.advance(pose)
        return solver.displacement, -float(wrench_of(self.unit.model, solver.nodal_force)[2])

    def frame(self, displacement: Array | None = None, gain: Array | float = 1.0) -> npt.NDArray[np.uint8]:
        """With the camera's noise; half a level of dither, as the light is scaled and not the picture."""
        image = self._renderer.image(self.unit.at_rest() if displacement is None else displacement, self.rng)
        lit = (image + self.rng.uniform(-0.5, 0.5, image.shape)) * gain
        return np.asarray(np.clip(np.round(lit), 0, 255), dtype=np.uint8)

    def learn(self, pipeline: Pipeline) -> None:
        """Rest, under the light of the calibration."""
        while not pipeline.process(self.frame()).has_reference:
            pass


def fitted_calibration(board: Board, twin: TwinSettings | None = None) -> bytes:
    """Operator and support of the board, colours of its twin or of `twin`; no error model."""
    kind = make_operator(board, method="support", noise=NOISE, n_touches=0)
    return container.pack(
        {**kind.tensors, **colours_of(board, twin=twin)}, {**container.base_metadata(board), **kind.metadata}
    ).data


def _drifts(board: Board, calibration: bytes, scene: Scene, progress: Progress) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    for drift in DRIFTS:
        for is_followed in (False, True):
            gain = 1 + drift * WAY
            with Pipeline(board, calibration) as pipeline:
                scene.learn(pipeline)
                for i in range(RAMP_FRAMES + SETTLE_FRAMES if is_followed else 0):
                    pipeline.process(scene.frame(gain=1 + drift * WAY * min(i / RAMP_FRAMES, 1)))
                still = pipeline.process(scene.frame(gain=gain))
                depth_um = float(np.sqrt((pipeline.depth_m() ** 2).mean()) * 1e6)
                press = pipeline.process(scene.frame(scene.pressed, gain))
            rows.append({
                "drift": drift, "is_followed": is_followed, "untouched_depth_um": depth_um,
                "untouched_force_n": float(np.linalg.norm(still.wrench[:3])),
                "press_error_n": -float(press.wrench[2]) - scene.force_n, "flags": still.flags | press.flags,
            })  # fmt: skip
            progress(len(rows) / (2 * len(DRIFTS)))
    return rows


def _held(board: Board, calibration: bytes, scene: Scene) -> dict[str, float]:
    """Reported force of a contact when it begins and after it was held; the light is steady."""
    pictures = [scene.frame(scene.pressed) for _ in range(16)]

    def force(frames: list[Frame]) -> float:
        return float(np.mean([-f.wrench[2] for f in frames]))

    with Pipeline(board, calibration) as pipeline:
        scene.learn(pipeline)
        first = force([pipeline.process(p) for p in pictures])
        for i in range(HELD_FRAMES):
            pipeline.process(pictures[i % len(pictures)])
        last = force([pipeline.process(p) for p in pictures])
    return {"frames": HELD_FRAMES, "first_n": first, "last_n": last}


def run(board: Board, *, progress: Progress = lambda _: None) -> dict[str, Any]:
    """All of it.

    Raises
    ------
    InputError
        The board has no twin, or its displacement does not come from dots and colours.
    """
    scene = Scene(board)
    calibration = fitted_calibration(board)
    progress(0.1)
    rows = _drifts(board, calibration, scene, lambda done: progress(0.1 + 0.2 * done))
    held = _held(board, calibration, scene)
    progress(0.5)
    warm = fitted_calibration(board, warming.warming_twin(board))
    warmed = warming.run(board, warm, lambda done: progress(0.5 + 0.5 * done))
    progress(1.0)
    return {
        "board": board.name, "simulated": True, "force_n": scene.force_n, "drift": rows, "held": held,
        "warming": warmed,
    }  # fmt: skip


def table(result: dict[str, Any]) -> str:
    """The result as text."""
    held = result["held"]
    lines = [
        f"{result['board']}, SIMULATED: light that drifts (B, G, R {WAY[0]:+g}, {WAY[1]:+g}, {WAY[2]:+g} times the "
        f"drift); a press of {result['force_n']:.3f} N",
        *aligned(("drift", "", "untouched depth", "untouched force", "press, error", "flags"), [
            (
                f"{100 * row['drift']:.0f} %", "followed, untouched" if row["is_followed"] else "at a stroke",
                f"{row['untouched_depth_um']:.1f} um", f"{row['untouched_force_n']:.3f} N",
                f"{row['press_error_n']:+.3f} N", row["flags"],
            )
            for row in result["drift"]
        ]),
    ]  # fmt: skip
    lines.append(f"held for {held['frames']} frames: {held['first_n']:.4f} N at first, {held['last_n']:.4f} N at last")
    lines.append(warming.table(result["warming"]))
    return "\n".join(lines)
