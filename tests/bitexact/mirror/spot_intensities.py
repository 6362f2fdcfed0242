"""Light of round spots relative to rest (firmware/stages/spot_intensities/spot_intensities.h), in integers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from mirror.board import Board
from mirror.fixed import I64, div_half_up

ONE, GAIN, NEAR = 1 << 16, 1 << 20, 6
LEAST_LEVEL, GREY_OF_LEVEL = 16, 48
SAME, MOST, STEP, STILL_FRAMES = 1311, 2621, 512, 16


class Seen(NamedTuple):
    """Features of a frame, and what is said of it."""

    features: I64
    n_lost: int
    is_light_wrong: bool


def grey_of(picture: npt.NDArray[np.integer]) -> I64:
    """12 (B + 2 G + R) of a frame's levels (h, w, 3)."""
    return np.asarray(12 * picture.astype(np.int64) @ np.array([1, 2, 1]))


def grey_of_rest(rest: I64) -> I64:
    """The same of 1/16 levels."""
    return np.asarray((3 * (rest.astype(np.int64) @ np.array([1, 2, 1])) + 2) >> 2)


def nominal_q8(board: Board) -> list[tuple[int, int]]:
    markers, camera, pad = board["markers"], board["camera"], board["pad"]
    places = markers.get("places_um") or [
        [markers["first_x_um"] + i * markers["pitch_x_um"], markers["first_y_um"] + j * markers["pitch_y_um"]]
        for j in range(markers["n_y"])
        for i in range(markers["n_x"])
    ]

    def projected(at: int, axis: str) -> int:
        distance, focal = camera["standoff_um"], camera["focal_mpx"]
        wide = 256 * camera[f"center_{axis}_mpx"] * distance + 128 * (2 * at - pad[f"size_{axis}_um"]) * focal
        return int(wide // (1000 * distance))

    return [(projected(x, "x"), projected(y, "y")) for x, y in places]


class SpotIntensities:
    """The spots of a board after a rest picture (h, w, 3) in 1/16 levels."""

    def __init__(self, board: Board, rest: I64) -> None:
        camera, markers = board["camera"], board["markers"]
        half = [
            128 * markers[key] * camera["focal_mpx"] // (1000 * camera["standoff_um"])
            for key in ("diameter_um", "pitch_x_um", "pitch_y_um")
        ]
        grey = grey_of_rest(rest)
        y, x = np.mgrid[: grey.shape[0], : grey.shape[1]].astype(np.int64)
        self.masks, self.rest, self.usable = [], [], []
        for at_x, at_y in nominal_q8(board):
            place = self._found(grey, at_x, at_y, half[1], half[2])
            mask = ((x << 8) - place[0]) ** 2 + ((y << 8) - place[1]) ** 2 <= half[0] ** 2
            total, n = int(grey[mask].sum()), int(mask.sum())
            n_full = int((rest.max(axis=2)[mask] >= 16 * 255 - 8).sum())
            self.masks.append(mask)
            self.rest.append(total)
            self.usable.append(total >= max(LEAST_LEVEL * GREY_OF_LEVEL * n, 1) and 8 * n_full < n)
        at = np.array(nominal_q8(board))
        distance = ((at[:, None] - at) ** 2).sum(axis=2)
        np.fill_diagonal(distance, np.iinfo(np.int64).max)
        self.near = np.argsort(distance, axis=1, kind="stable")[:, : min(NEAR, len(at) - 1)]
        self.gain, self.n_still, self.max_lost = GAIN, 0, markers["max_lost"]

    @staticmethod
    def _found(grey: I64, x_q8: int, y_q8: int, reach_x: int, reach_y: int) -> tuple[int, int]:
        height, width = grey.shape
        x0, y0 = (
            min(max((at - reach) >> 8, 0), n) for at, reach, n in ((x_q8, reach_x, width), (y_q8, reach_y, height))
        )
        x1 = min(max(((x_q8 + reach_x) >> 8) + 1, x0), width)
        y1 = min(max(((y_q8 + reach_y) >> 8) + 1, y0), height)
        part = grey[y0:y1, x0:x1]
        if not part.size:
            return x_q8, y_q8
        weight = np.maximum(part - (part.min() + part.max()) // 2, 0)
        if not weight.any():
            return x_q8, y_q8
        y, x = np.mgrid[y0:y1, x0:x1]
        total = int(weight.sum())
        return tuple(int(div_half_up(np.int64(256 * (weight * along).sum()), total)) for along in (x, y))  # type: ignore[return-value]

    def run(self, frame: npt.NDArray[np.uint8], *, is_wrong: bool = False) -> Seen:
        grey, full = grey_of(frame), frame.max(axis=2) == 255
        features, lost = np.zeros(len(self.masks), np.int64), np.zeros(len(self.masks), bool)
        for k, (mask, rest, is_usable) in enumerate(zip(self.masks, self.rest, self.usable, strict=True)):
            now = int(grey[mask].sum())
            lost[k] = not is_usable or 16 * now < rest or 8 * int(full[mask].sum()) >= int(mask.sum())
            if not lost[k]:
                ratio = int(div_half_up(np.int64(now * ONE), rest))
                features[k] = int(div_half_up(np.int64(ratio * GAIN), self.gain)) - ONE
        is_light_wrong = self._follow(np.sort(features[~lost]), is_wrong or bool(lost.sum() > self.max_lost))
        for k in np.flatnonzero(lost):
            seen = [i for i in self.near[k] if not lost[i]]
            features[k] = int(div_half_up(features[seen].sum(), len(seen))) if seen else 0
        return Seen(features, int(lost.sum()), is_light_wrong)

    def _follow(self, seen: I64, is_wrong: bool) -> bool:
        """`seen`: in order."""
        numbers = [int(np.searchsorted(seen, low + SAME, side="right")) - i for i, low in enumerate(seen)]
        n = max(numbers, default=0)
        first = numbers.index(n) if n else 0
        light = int(seen[first + n // 2]) if n else 0
        is_light_wrong = n > 0 and 2 * n >= len(seen) and abs(light) > MOST
        is_still = 0 < n == len(seen) and not is_light_wrong and not is_wrong
        self.n_still = min(self.n_still + 1, STILL_FRAMES) if is_still else 0
        if self.n_still == STILL_FRAMES:
            self.gain = min(max(self.gain + min(max(light, -STEP), STEP), GAIN * 3 // 4), GAIN * 5 // 4)
        return bool(is_light_wrong)
