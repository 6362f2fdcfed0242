"""Old pictures and old parts of pictures against the mirror: drawn sequences through the path of a live camera."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from ruffini.boards import parse_board
from ruffini.core import Pipeline

BASE = Path(__file__).parents[1] / "data" / "boards" / "base.toml"
REPEATED = 32768
COLUMNS, SAMPLES, REMEMBERED, FEWEST = 4, 16, 31, 2
Picture = npt.NDArray[np.uint8]


class Mirror:
    """firmware/image/repeated_pictures.h, in Python's own integers."""

    def __init__(self, width: int, height: int) -> None:
        rows = -(-height // 240) * 8
        rows, bands, lot = min(rows, height), max(height // rows, 1), 1

        def draw(n: int) -> int:
            nonlocal lot
            drawn, lot = (lot >> 16) % n, (lot * 1103515245 + 12345) % 2**32
            return drawn

        self.places = []
        for band in range(bands):
            for column in range(COLUMNS):
                left, top = column * (width // COLUMNS), band * rows
                drawn = [(left + draw(width // COLUMNS), top + draw(rows)) for _ in range(SAMPLES - 1)]
                self.places.append([(left, top), *drawn])
        self.before: list[list[int]] = []
        self.repeats_itself, self.quiet = False, set[int]()

    def cells(self, picture: Picture) -> list[int]:
        found = []
        for places in self.places:
            mixed = level = 0
            for x, y in places:
                b, g, r = (int(v) for v in picture[y, x])
                level += b + g + r
                mixed = (mixed + b + 256 * g + 65536 * r + 1) * 0x9E3779B97F4A7C15 % 2**64
            found.append(max(mixed >> 32, 1) if 3 * SAMPLES * 2 < level < 3 * SAMPLES * 253 else 0)
        return found

    def see(self, picture: Picture, *, is_rest: bool) -> bool:
        now = self.cells(picture)
        equal = [sum(a == b != 0 for a, b in zip(now, old, strict=True)) for old in self.before]
        before, self.before = self.before, [*self.before, now][-REMEMBERED:]
        loud = [{i for i, c in enumerate(now) if c and c == old[i]} - self.quiet for old in before]
        most = max(map(len, loud), default=0)
        if is_rest:
            self.repeats_itself |= most > 0
            return False
        if most == 1:
            self.quiet |= next(cells for cells in loud if cells)
        whole = max(equal, default=0)
        return (whole > 0 and whole == sum(c != 0 for c in now)) or (not self.repeats_itself and most >= FEWEST)


def test_the_flag_is_the_mirrors() -> None:
    board, rng = parse_board(BASE.read_bytes(), "sample"), np.random.default_rng(8)
    height, width = board.camera.height_px, board.camera.width_px
    for has_noise in (True, False):
        mirror, shown, said = Mirror(width, height), [], []
        with Pipeline(board) as core:
            core.set_live()
            for i in range(board.pipeline.n_rest_frames + 90):
                picture = rng.integers(60, 190, (height, width, 3), np.uint8)
                turn, is_rest = rng.integers(6), i < board.pipeline.n_rest_frames
                if shown and (not has_noise if is_rest else turn < 4):
                    old = shown[-int(rng.integers(1, min(len(shown), 36) + 1))]
                    y, x = np.sort(rng.integers(0, height + 1, 2)), np.sort(rng.integers(0, width + 1, 2))
                    part = (slice(*y), slice(*x)) if turn else (slice(None), slice(None))
                    picture[part] = old[part]
                if turn == 5:
                    picture[: height // 2] = 255 if i % 2 else 0
                expected = mirror.see(picture, is_rest=is_rest)
                assert bool(core.process(picture).flags & REPEATED) == expected, i
                shown.append(picture)
                said.append(expected)
        assert mirror.repeats_itself == (not has_noise)
        assert 5 < sum(said) < 70, sum(said)
