"""Stick and slip of each contact: carried places, rim against core, friction. As firmware/stages/contacts/slip.h."""

from __future__ import annotations

from dataclasses import dataclass
from math import isqrt

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from mirror.board import Board, observed_nodes
from mirror.fixed import I64

UNKNOWN, STICKS, INCIPIENT, SLIDES = range(4)
FREE, NODE_STICKS, NODE_SLIPS = range(3)
ONE = 1 << 16
SLACK = 15 * 8  # of 1/8 um
MAX_LISTED = 8
# 1 - (1 - x)^(2/3) in thousandths at x = 0, 1/32, ... 1.
SHARE = [int(1000 * (1 - (1 - i / 32) ** (2 / 3)) + 0.5) for i in range(33)]


@dataclass(frozen=True)
class Slip:
    """One contact; friction 0: not measured."""

    state: int
    ratio_1e3: int
    friction_1e3: int
    friction_sigma_1e3: int
    share_1e3: int
    margin_un: int


def _um(board: Board, axis: str) -> I64:
    steps, size = board["grid"][f"n_{axis}"] - 1, board["pad"][f"size_{axis}_um"]
    twice = 2 * np.array(observed_nodes(board, axis), np.int64) - steps
    return (twice * size + steps) // (2 * steps)


def _half_up(a: int, b: int) -> int:
    return (2 * a + b) // (2 * b)


def depth_of(pressed: npt.NDArray[np.bool_]) -> I64:
    """Steps to the nearest node that is not pressed, diagonal ones counting one, at most 7."""
    left, depth = np.pad(pressed, 1), np.zeros(pressed.shape, np.int64)
    for _ in range(7):
        depth += left[1:-1, 1:-1]
        left = ndimage.minimum_filter(left, size=3, mode="constant")
    return depth


class SlipTracker:
    """Carries the nodes' memory from frame to frame."""

    def __init__(self, board: Board) -> None:
        self.x, self.y = np.meshgrid(_um(board, "x"), _um(board, "y"))
        self.lsb = board["field"]["force_lsb_un"]
        shape = self.x.shape
        self.anchor = np.zeros((*shape, 2), np.int64)
        self.friction, self.phase = np.zeros(shape, np.int64), np.zeros(shape, np.int64)
        self.held = np.zeros(shape, bool)

    def forget(self) -> None:
        self.held[:] = False

    def track(self, mask: I64, force: I64, u: I64) -> tuple[npt.NDArray[np.uint8], list[Slip]]:
        """Node plane and slip of the listed contacts, in their order."""
        shape = self.x.shape
        f, place = force.reshape(*shape, 3), u.reshape(*shape, 3)[..., :2]
        number, n = ndimage.label(mask.reshape(shape) > 0, structure=np.ones((3, 3)))
        first = {k: int(np.flatnonzero(number == k)[0]) for k in range(1, n + 1)}
        area = {k: int(((number == k) & (f[..., 2] < 0)).sum()) for k in first}
        listed = sorted((k for k in first if area[k] > 0), key=lambda k: (-area[k], first[k]))[:MAX_LISTED]
        plane, slips = np.zeros(shape, np.uint8), []
        held, self.held = self.held, np.zeros(shape, bool)
        for k in listed:
            inside = number == k
            peak = int((-f[..., 2])[inside].max())
            pressed = inside & (5 * -f[..., 2] > peak)
            slips.append(self._contact(pressed, held & pressed, f, place, plane))
            self.held |= pressed
        return plane, slips

    def _contact(
        self, pressed: npt.NDArray[np.bool_], held: npt.NDArray[np.bool_], f: I64, place: I64,
        plane: npt.NDArray[np.uint8],
    ) -> Slip:  # fmt: skip
        depth = depth_of(pressed)
        friction = int(self.friction[held].max(initial=0))
        phase = int(self.phase[held].max(initial=0))
        slipped = self._follow(pressed, held, depth, place)
        plane[pressed] = NODE_STICKS
        plane[slipped] = NODE_SLIPS
        slip, friction, phase = self._judge(
            pressed, pressed & (depth == 1), int(held.sum()), int(slipped.sum()), f, friction, phase
        )
        self.friction[pressed], self.phase[pressed] = friction, phase
        if slip.state == SLIDES:
            plane[pressed] = NODE_SLIPS
        elif friction and slip.state != UNKNOWN:
            for at in zip(*np.nonzero(pressed), strict=True):
                x, y, z = (int(v) for v in f[at])
                if 10 * ONE * isqrt(x * x + y * y) >= 9 * friction * -z:
                    plane[at] = NODE_SLIPS
        return slip

    def _follow(
        self, pressed: npt.NDArray[np.bool_], held: npt.NDArray[np.bool_], depth: I64, place: I64
    ) -> npt.NDArray[np.bool_]:
        """Move the anchors with the indenter; which nodes it left behind."""
        slipped = np.zeros(pressed.shape, bool)
        self.anchor[pressed & ~held] = place[pressed & ~held]
        if not held.any():
            return slipped
        w, moved = depth[held] ** 4, (place - self.anchor)[held]
        x, y = self.x[held], self.y[held]
        total = int(w.sum())
        mean_x, mean_y = int((w * x).sum()) // total, int((w * y).sum()) // total
        go_x, go_y = (_half_up(int((w * moved[:, c]).sum()), total) for c in (0, 1))
        arm_x, arm_y = x - mean_x, y - mean_y
        turn = 0
        spread = int((w * (arm_x**2 + arm_y**2)).sum()) >> 20
        if len(w) >= 9 and spread >= 64:
            twist = int((w * (arm_x * (moved[:, 1] - go_y) - arm_y * (moved[:, 0] - go_x))).sum())
            turn = min(max(twist // spread, -(1 << 20)), 1 << 20)
        rest_x = moved[:, 0] - go_x + ((turn * arm_y) >> 20)
        rest_y = moved[:, 1] - go_y - ((turn * arm_x) >> 20)
        for i, at in enumerate(zip(*np.nonzero(held), strict=True)):
            rest = np.array([rest_x[i], rest_y[i]])
            length2 = int(rest_x[i]) ** 2 + int(rest_y[i]) ** 2
            if length2 >= SLACK * SLACK:
                slipped[at] = True
                rest = rest * SLACK // isqrt(length2)
            self.anchor[at] = place[at] - rest
        return slipped

    def _judge(
        self, pressed: npt.NDArray[np.bool_], rim: npt.NDArray[np.bool_], n_held: int, n_slipped: int, f: I64,
        friction: int, phase: int,
    ) -> tuple[Slip, int, int]:  # fmt: skip
        whole = [int(v) for v in f[pressed].sum(axis=0)]
        edge = [int(v) for v in f[rim].sum(axis=0)]
        shift = max(max(abs(v) for v in (*whole, *edge)).bit_length() - 30, 0)
        fx, fy, fn = whole[0] >> shift, whole[1] >> shift, -whole[2] >> shift
        rx, ry, rn = edge[0] >> shift, edge[1] >> shift, -edge[2] >> shift
        n, n_rim = int(pressed.sum()), int(rim.sum())
        if n_held < 4 or n_rim == n or rn <= 0 or fn <= rn:
            return Slip(UNKNOWN, 0, 0, 0, 0, 0), friction, phase
        tangential = isqrt(fx * fx + fy * fy)
        along = (rx * fx + ry * fy) // tangential if tangential else 0
        ratio = min((tangential << 16) // fn, 16 * ONE)
        at_rim = min(max((along << 16) // rn, 0), 16 * ONE)
        in_core = min(max((tangential - along << 16) // (fn - rn), 0), 16 * ONE)
        even = 1000 * in_core // at_rim if at_rim else 0
        share = 1000 * n_slipped // n
        state = STICKS
        was = phase & 3
        if friction == 0:
            if share >= 350 and even >= 600 and 100 * ratio >= 3 * ONE:
                friction, state = at_rim, INCIPIENT
        else:
            if even >= 880 and 100 * ratio >= 85 * friction:
                friction += (ratio - friction) // 4
            elif at_rim > friction:
                friction += (at_rim - friction) // 4
            used = 1000 * ratio // friction
            if (used >= 970 and even >= 920) or (was == SLIDES and used >= 900):
                state = SLIDES
            elif used >= (600 if was >= INCIPIENT else 700):
                state = INCIPIENT
        phase = (phase & 4) | state | (4 if state == SLIDES else 0)
        if state == SLIDES:
            share = 1000
        elif friction:
            share = max(share, _share(min(ratio * 1024 // friction, 1024)))
        margin = (((friction * fn) >> 16) - tangential << shift) * self.lsb if friction else 0
        sigma = friction * (3 if phase & 4 else 20) // 100
        slip = Slip(state, (ratio * 1000) >> 16, (friction * 1000) >> 16, (sigma * 1000) >> 16, share, margin)
        return slip, friction, phase


def _share(used: int) -> int:
    """Slipping share of the contact, thousandths, where `used` / 1024 of the friction is used: between table lines."""
    line, part = min(used >> 5, 31), used - (min(used >> 5, 31) << 5)
    return (SHARE[line] * (32 - part) + SHARE[line + 1] * part) >> 5
