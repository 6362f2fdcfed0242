"""Map of how deep the gel is pressed (firmware/stages/contact_depth/contact_depth.h)."""

from __future__ import annotations

from math import isqrt

import numpy as np

from mirror.board import Board
from mirror.contact_model import Perceptron, Profile, Tensors
from mirror.fixed import I64, Saturations, round_shift
from mirror.program import Program

MOST_INPUT = 1 << 20


def smoothed(plane: I64, times: int) -> I64:
    for _ in range(times):
        edged = np.pad(plane, 1, mode="edge")
        along = edged[:, :-2] + 2 * edged[:, 1:-1] + edged[:, 2:]
        plane = round_shift(along[:-2] + 2 * along[1:-1] + along[2:], 4)
    return plane


class ContactDepth:
    """The tables of kind `contact_depth`."""

    def __init__(self, board: Board, tensors: Tensors, metadata: dict[str, str]) -> None:
        m, camera, pad = board["markers"], board["camera"], board["pad"]
        self._shape = (m["n_y"], m["n_x"])
        self._pitch = (m["pitch_x_um"], m["pitch_y_um"])
        self._first = [(2 * m[f"first_{a}_um"] - pad[f"size_{a}_um"]) << 3 for a in "xy"]
        pitch_px = min(self._pitch) * camera["focal_mpx"] // (1000 * camera["standoff_um"])
        self.step_px = max(pitch_px, board["depth"]["step_px"])
        um_per_px = (camera["standoff_um"] * 1000 << 20) // camera["focal_mpx"]
        self._seen = [
            np.array(
                [self._place(i, camera[f"center_{a}_mpx"], um_per_px) for i in range(camera[size] // self.step_px)]
            )
            for a, size in zip("xy", ("width_px", "height_px"), strict=True)
        ]
        self._linear = Program(tensors, metadata, "contact_depth.linear")
        self._net = Perceptron(tensors, "contact_depth.net")

    def _place(self, cell: int, center_mpx: int, um_per_px: int) -> int:
        twice_mpx = (2 * cell * self.step_px + self.step_px - 1) * 1000 - 2 * center_mpx
        return (twice_mpx * um_per_px + (1 << 16) >> 17) // 1000

    def run(self, flow: I64, fall: I64, profile: Profile, inputs: list[int], saturations: Saturations) -> I64:
        """u_z of each cell in 1/8 um; flow (n_y, n_x, 2) in 1/16 um, inputs of the contact model."""
        first = self._linear.times(saturations.clamp(flow.ravel(), -(1 << 15), (1 << 15) - 1)).reshape(self._shape)
        few = smoothed(first, 2)
        planes = [first, few, smoothed(few, 6)]
        depth = self._depth(planes, fall, profile, inputs, saturations)
        x, y = np.meshgrid(*(s - f for s, f in zip(self._seen, self._first, strict=True)))
        lay = x, y
        for _ in range(2):
            moved = self._at(flow, *lay)
            lay = x - moved[..., 0], y - moved[..., 1]
        told = self._at(depth[..., None], *lay)[..., 0]
        return saturations.clamp(-round_shift(told, 1), -(1 << 15), (1 << 15) - 1)

    def _depth(
        self, planes: list[I64], fall: I64, profile: Profile, inputs: list[int], saturations: Saturations
    ) -> I64:
        size = max(profile.size, 1)
        largest = int(planes[0].max())
        out = np.zeros(self._shape, np.int64)
        for row, column in np.ndindex(*self._shape):
            away = [
                (f + (i * p << 4) >> 4) - c
                for f, i, p, c in zip(self._first, (column, row), self._pitch, profile.center, strict=True)
            ]
            own = [(int(plane[row, column]) << 10) // size for plane in planes]
            own += [(largest << 10) // size, (int(fall[row, column]) << 8) // size]
            own = [min(max(v, -MOST_INPUT), MOST_INPUT) for v in own]
            x = [*own, isqrt(away[0] ** 2 + away[1] ** 2), *inputs]
            if max(abs(v) for v in x) > MOST_INPUT:
                saturations.count += 1
                continue
            ratio = min(max(self._net(x)[0], -(1 << 20)), 1 << 20)
            told = (ratio * profile.size + (1 << 11)) >> 12
            out[row, column] = min(max(told, -64_000), 64_000)
            saturations.count += int(abs(told) > 64_000)
        return out

    def _at(self, values: I64, x: I64, y: I64) -> I64:
        """Bilinear between the patches, at places from the first one."""
        lines, parts = [], []
        for place, pitch, n in zip((x, y), self._pitch, self._shape[::-1], strict=True):
            at = ((place << 6) // pitch).clip(0, (n - 1) << 10)
            line = np.minimum(at >> 10, n - 2)
            lines.append(line)
            parts.append((at - (line << 10))[..., None])
        (i, j), (p, q) = lines, parts
        upper = (1024 - p) * values[j, i] + p * values[j, i + 1]
        lower = (1024 - p) * values[j + 1, i] + p * values[j + 1, i + 1]
        return round_shift((1024 - q) * upper + q * lower, 20)
