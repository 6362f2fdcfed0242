"""What the simulated rig does: stories of touches, frame by frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ruffini.boards import Board
from ruffini.sim.contact import Indenter, Pose


@dataclass(frozen=True)
class Touch:
    """One approach with one indenter: its pose in every frame, and which frames are judged."""

    indenter: Indenter
    poses: list[Pose]
    judged: list[bool]


def rest_frames(n: int) -> list[None]:
    """n frames in which nothing touches."""
    return [None] * n


def _ramp(start: Pose, end: Pose, n: int) -> list[Pose]:
    """n poses from start (excluded) to end (included)."""
    out = []
    for i in range(1, n + 1):
        t = i / n
        out.append(
            Pose(
                start.x_m + t * (end.x_m - start.x_m),
                start.y_m + t * (end.y_m - start.y_m),
                start.depth_m + t * (end.depth_m - start.depth_m),
                start.turn_rad + t * (end.turn_rad - start.turn_rad),
            )
        )
    return out


def demo(board: Board) -> Iterator[Touch | int]:
    """A story of about 150 frames; an int is a number of untouched frames."""
    mm = 1e-3

    def story(indenter: Indenter, x: float, y: float, waypoints: list[tuple[float, float, float, float, int]]) -> Touch:
        pose, poses = Pose(x * mm, y * mm, 0.0), []
        for dx, dy, depth, turn, n in waypoints:
            target = Pose((x + dx) * mm, (y + dy) * mm, depth * mm, turn)
            poses += _ramp(pose, target, n)
            pose = target
        return Touch(indenter, poses, [True] * len(poses))

    yield 12
    yield story(
        Indenter("sphere", 3 * mm), -3, -1,
        [(0, 0, 1.0, 0, 12), (0.5, 0, 1.0, 0, 8), (-0.5, 0, 1.0, 0, 14), (0, 0.4, 1.0, 0, 8), (0, 0.4, 0, 0, 8)],
    )  # fmt: skip
    yield 6
    yield story(
        Indenter("flat", 2.5 * mm), 2.5, 1,
        [(0, 0, 0.8, 0, 12), (0, 0, 0.8, 0.15, 8), (0.3, -0.3, 0.8, 0.15, 8), (0.3, -0.3, 0, 0.15, 10)],
    )  # fmt: skip
    yield 6
    yield story(
        Indenter("sphere", 2 * mm), 5, -4, [(0, 0, 0.9, 0, 12), (-0.4, 0.3, 0.9, 0, 8), (-0.4, 0.3, 0, 0, 8)]
    )
    yield 8


def random_touch(board: Board, rng: np.random.Generator) -> Touch:
    """A press for judging: a ball or a flat, 0.3-1.2 mm deep, half of them sheared; its last frames judged."""
    shape = "sphere" if rng.random() < 0.65 else "flat"
    radius = rng.uniform(2e-3, 4e-3) if shape == "sphere" else rng.uniform(1.5e-3, 3e-3)
    depth = rng.uniform(0.3e-3, 1.2e-3)
    margin = 4.0e-3
    x = rng.uniform(-1, 1) * (board.pad.size_x_um * 5e-7 - margin)
    y = rng.uniform(-1, 1) * (board.pad.size_y_um * 5e-7 - margin)
    start, down = Pose(x, y, 0.0), Pose(x, y, depth)
    poses = _ramp(start, down, 5)
    judged = [False] * 4 + [True]
    if rng.random() < 0.5:
        angle, size = rng.uniform(0, 2 * np.pi), rng.uniform(0.1, 0.5) * depth
        sheared = Pose(x + size * np.cos(angle), y + size * np.sin(angle), depth)
        poses += _ramp(down, sheared, 3)
        judged = [False] * 7 + [True]
    return Touch(Indenter(shape, radius), poses, judged)


def grid(board: Board, n: int, rng: np.random.Generator) -> Iterator[Touch | int]:
    """n independent presses, each followed by two untouched frames."""
    yield board.pipeline.n_rest_frames + 2
    for _ in range(n):
        yield random_touch(board, rng)
        yield 2


def ball_presses(board: Board, n: int, ball_radius_m: float, rng: np.random.Generator) -> list[tuple[Indenter, Pose]]:
    """n presses of a calibration ball, spread over the pad at different depths."""
    margin = 2.5e-3
    presses = []
    for i in range(n):
        # A low-discrepancy sequence covers the pad evenly at any n (Roberts' R2).
        u, v = (0.5 + (i + 1) * np.array([0.7548776662, 0.5698402910])) % 1
        x = (2 * u - 1) * (board.pad.size_x_um * 5e-7 - margin)
        y = (2 * v - 1) * (board.pad.size_y_um * 5e-7 - margin)
        presses.append((Indenter("sphere", ball_radius_m), Pose(x, y, rng.uniform(0.4e-3, 1.2e-3))))
    return presses
