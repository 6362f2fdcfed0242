"""What the simulated rig does: stories of touches, frame by frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.sim.contact import Indenter, Pose

MM = 1e-3


@dataclass(frozen=True)
class Touch:
    """One approach with one indenter: its pose in every frame, and which frames are judged."""

    indenter: Indenter
    poses: list[Pose]
    judged: list[bool]


@dataclass(frozen=True)
class Rest:
    """Frames in which nothing touches."""

    n_frames: int


@dataclass(frozen=True)
class Load:
    """A rigid connector in the pad's place: wrench about the pad's centre in every frame, (n, 6) N and N m."""

    wrenches: npt.NDArray[np.float64]
    judged: list[bool]


Step = Touch | Rest | Load


def n_frames_of(story: list[Step]) -> int:
    """Frames that a story takes."""
    return sum(step.n_frames if isinstance(step, Rest) else len(step.judged) for step in story)


def _ramp(start: Pose, end: Pose, n: int) -> list[Pose]:
    """n poses from start (excluded) to end (included)."""
    return [start.towards(end, i / n) for i in range(1, n + 1)]


@dataclass(frozen=True)
class _Way:
    """Where a touch goes next: from its first place (mm), depth (mm), turn, and in how many frames."""

    dx: float
    dy: float
    depth: float
    turn: float
    n: int


def _told(indenter: Indenter, x_mm: float, y_mm: float, ways: list[_Way]) -> Touch:
    pose, poses = Pose(x_mm * MM, y_mm * MM, 0.0), []
    for way in ways:
        target = Pose((x_mm + way.dx) * MM, (y_mm + way.dy) * MM, way.depth * MM, way.turn)
        poses += _ramp(pose, target, way.n)
        pose = target
    return Touch(indenter, poses, [True] * len(poses))


def demo(board: Board) -> list[Step]:
    """About 160 frames: a ball pressed and sheared, a flat punch pressed and twisted, a ball off centre."""
    part_x, part_y = board.pad.size_x_um * 1e-3, board.pad.size_y_um * 1e-3  # mm
    return [
        Rest(board.pipeline.n_rest_frames + 8),
        _told(
            Indenter("sphere", 3 * MM), -0.15 * part_x, -0.06 * part_y,
            [_Way(0, 0, 1.0, 0, 12), _Way(0.5, 0, 1.0, 0, 8), _Way(-0.5, 0, 1.0, 0, 14),
             _Way(0, 0.4, 1.0, 0, 8), _Way(0, 0.4, 0, 0, 8)],
        ),
        Rest(6),
        _told(
            Indenter("flat", 2.5 * MM), 0.12 * part_x, 0.06 * part_y,
            [_Way(0, 0, 0.8, 0, 12), _Way(0, 0, 0.8, 0.15, 8), _Way(0.3, -0.3, 0.8, 0.15, 8),
             _Way(0.3, -0.3, 0, 0.15, 10)],
        ),
        Rest(6),
        _told(
            Indenter("sphere", 2 * MM), 0.25 * part_x, -0.25 * part_y,
            [_Way(0, 0, 0.9, 0, 12), _Way(-0.4, 0.3, 0.9, 0, 8), _Way(-0.4, 0.3, 0, 0, 8)],
        ),
        Rest(8),
    ]  # fmt: skip


def random_touch(board: Board, rng: np.random.Generator) -> Touch:
    """A press for judging: a ball of 4-8 mm or a flat of 3-6 mm, 0.3-1.2 mm deep, half of them sheared.

    The last frame before release is judged; then the indenter leaves in two frames.
    """
    shape = "sphere" if rng.random() < 0.65 else "flat"
    radius = rng.uniform(2, 4) * MM if shape == "sphere" else rng.uniform(1.5, 3) * MM
    depth = rng.uniform(0.3, 1.2) * MM
    margin = 4 * MM
    x = rng.uniform(-1, 1) * (board.pad.size_x_um * 5e-7 - margin)
    y = rng.uniform(-1, 1) * (board.pad.size_y_um * 5e-7 - margin)
    held = Pose(x, y, depth)
    poses = _ramp(Pose(x, y, 0.0), held, 4)
    if rng.random() < 0.5:
        angle, size = rng.uniform(0, 2 * np.pi), rng.uniform(0.1, 0.5) * depth
        down, held = held, Pose(x + size * np.cos(angle), y + size * np.sin(angle), depth)
        poses += _ramp(down, held, 3)
    judged = [False] * (len(poses) - 1) + [True]
    away = _ramp(held, Pose(held.x_m, held.y_m, 0.0), 2)
    return Touch(Indenter(shape, radius), poses + away, judged + [False] * len(away))


def sheared_and_turned(board: Board, n: int, rng: np.random.Generator) -> list[Step]:
    """n presses for judging, an untouched frame after each: a ball of 4-8 mm or a flat of 3-6 mm, 0.3-1.0 mm deep,
    all of them sheared by 0.1 to 0.5 of the depth, half turned by 0.03 to 0.12 rad as well. The last frame is judged.
    """
    story: list[Step] = [Rest(board.pipeline.n_rest_frames + 2)]
    half_x, half_y, margin = board.pad.size_x_um * 5e-7, board.pad.size_y_um * 5e-7, 4 * MM
    for _ in range(n):
        is_ball = rng.random() < 0.6
        indenter = Indenter("sphere", rng.uniform(2, 4) * MM) if is_ball else Indenter("flat", rng.uniform(1.5, 3) * MM)
        depth = rng.uniform(0.3, 1.0) * MM
        x, y = rng.uniform(-1, 1) * (half_x - margin), rng.uniform(-1, 1) * (half_y - margin)
        angle, shift = rng.uniform(0, 2 * np.pi), rng.uniform(0.1, 0.5) * depth
        turn = rng.choice([-1, 1]) * rng.uniform(0.03, 0.12) if rng.random() < 0.5 else 0.0
        down = Pose(x, y, depth)
        held = Pose(x + shift * np.cos(angle), y + shift * np.sin(angle), depth, turn)
        poses = _ramp(Pose(x, y, 0.0), down, 4) + _ramp(down, held, 3)
        story += [Touch(indenter, poses, [False] * (len(poses) - 1) + [True]), Rest(1)]
    return story


def grid(board: Board, n: int, rng: np.random.Generator) -> list[Step]:
    """n independent presses, each followed by two untouched frames."""
    return [Rest(board.pipeline.n_rest_frames + 2), *_presses(board, n, rng)]


def _presses(board: Board, n: int, rng: np.random.Generator) -> Iterator[Step]:
    for _ in range(n):
        yield random_touch(board, rng)
        yield Rest(2)


def ball_presses(board: Board, n: int, ball_radius_m: float, rng: np.random.Generator) -> list[tuple[Indenter, Pose]]:
    """n presses of a calibration ball, spread over the pad at different depths."""
    margin = 2.5 * MM
    presses = []
    for i in range(n):
        # A low-discrepancy sequence covers the pad evenly at any n (Roberts' R2).
        u, v = (0.5 + (i + 1) * np.array([0.7548776662, 0.5698402910])) % 1
        x = (2 * u - 1) * (board.pad.size_x_um * 5e-7 - margin)
        y = (2 * v - 1) * (board.pad.size_y_um * 5e-7 - margin)
        presses.append((Indenter("sphere", ball_radius_m), Pose(x, y, rng.uniform(0.4, 1.2) * MM)))
    return presses
