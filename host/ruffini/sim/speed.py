"""How fast the twin is: mechanics and rendering apart, on one core."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from ruffini.boards import Board
from ruffini.sim.contact import Indenter, Pose
from ruffini.sim.units import build_unit

N_FRAMES = 20
PRESS = (3e-3, 0.8e-3)  # ball radius and depth of the mechanics' press, metres


def measure(board: Board) -> dict[str, Any]:
    """Frames per second and memory of one board's twin, one thread."""
    import cv2
    from threadpoolctl import threadpool_limits

    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        with threadpool_limits(1):
            return _measure(board)
    finally:
        cv2.setNumThreads(before)


def _measure(board: Board) -> dict[str, Any]:
    unit = build_unit(board)
    renderer, rig = unit.renderer(), unit.rig()
    rig.take(Indenter("sphere", PRESS[0]))
    poses = [Pose(0.0, 0.0, PRESS[1] * (i + 1) / N_FRAMES) for i in range(N_FRAMES)]
    mechanics_fps = _rate(lambda i: rig.advance(poses[i]))
    displacement, tray = rig.displacement, rig.tray
    rng = np.random.default_rng(1)
    renderer.image(displacement, rng, tray=tray)  # the first one warms caches
    return {
        "board": board.name, "resolution": board.resolution, "rendering_fps": _rate(
            lambda _: renderer.image(displacement, rng, tray=tray)), "mechanics_fps": mechanics_fps,
        "memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3,
    }  # fmt: skip


def _rate(work: Callable[[int], object]) -> float:
    start = time.perf_counter()
    for i in range(N_FRAMES):
        work(i)
    return N_FRAMES / (time.perf_counter() - start)
