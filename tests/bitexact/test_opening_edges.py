"""What the edges of a skin's openings tell, against the mirror: a camera that moved, a curve that changed."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
from mirror.board import read_board
from mirror.skin import OpeningEdges, Taxels, base_of, glow_of
from test_skin_stage import N_REST, N_X, N_Y, calibration, openings, runs_of, skin_text

from ruffini.bench import picture_faults as faults
from ruffini.boards import parse_board
from ruffini.calibrate.container import pack
from ruffini.core import Pipeline

Picture = npt.NDArray[np.uint8]
SCALE = 6  # of the small skin's picture
LIGHT, FEATURES = 1024, 2048
NUMBER = np.kron(openings(), np.ones((SCALE, SCALE), int))
HEIGHT, WIDTH = NUMBER.shape


def text_of_large_skin() -> str:
    text = skin_text()
    for key, value in (("width_px", WIDTH), ("height_px", HEIGHT),
                       ("center_x_mpx", 500 * WIDTH), ("center_y_mpx", 500 * HEIGHT)):  # fmt: skip
        start = text.index(f"{key} = ")
        text = text[:start] + f"{key} = {value}" + text[text.index("\n", start) :]
    return text


def picture(rng: np.random.Generator, touched: int | None = None, light: float = 1.0) -> Picture:
    """Openings with soft edges, one of them three times as bright."""
    brighter = np.ones(N_X * N_Y + 2)
    if touched is not None:
        brighter[touched] = 3.0
    level = 40 * light * np.append(brighter[: N_X * N_Y], [0.0, 0.0])[NUMBER]
    grey = cv2.GaussianBlur(level, (0, 0), 2.0)[..., None] * np.array([1.2, 1.0, 0.6]) + 1.0
    return np.asarray(np.clip(np.round(grey + rng.normal(0, 1, grey.shape)), 0, 255), dtype=np.uint8)


def test_motion_and_curve_are_those_of_the_mirror_and_touches_are_neither() -> None:
    text = text_of_large_skin()
    board, rng = read_board(text), np.random.default_rng(12)
    made = calibration(board, text, rng)
    run = runs_of(NUMBER)
    file = pack({**made.tensors, "skin.run": run}, {**made.metadata, "skin.runs": str(len(run))})
    rest = [picture(rng) for _ in range(N_REST)]
    base = base_of(((16 * np.sum(rest, axis=0, dtype=np.int64) + N_REST // 2) // N_REST).astype(np.uint16), board)
    taxels, edges = Taxels(file.tensors, file.metadata), OpeningEdges(board, base)
    taxels.learn(base)
    good = [picture(rng, k, 1 + 0.004 * (k - 5)) for k in range(0, N_X * N_Y, 4)]
    motions = [faults.moved((way * np.cos(a), way * np.sin(a))) for way, a in zip(
        np.linspace(0.1, 0.4, 13), rng.uniform(0, 2 * np.pi, 13), strict=True)]  # fmt: skip
    moved = [*motions, faults.moved(zoom=1.003), faults.moved(turn_deg=0.3), faults.slipped(0.3, 0.7, 2)]
    curves = [faults.toned(gamma) for gamma in (0.94, 0.97, 1.02, 1.04, 1.08)]
    bad = [fault(picture(rng, 9), rng) for fault in (*moved, *curves)]
    told = []
    with Pipeline(parse_board(text.encode(), "small"), file.data) as core:
        for frame in rest:
            core.process(frame)
        for frame in (*good, *bad):
            flags = core.process(frame).flags
            glow = glow_of(frame, base, board)
            taxels.run(glow)
            told.append((edges.moved(glow, taxels.light), edges.off_curve(glow, taxels.light)))
            assert bool(flags & FEATURES) == told[-1][0]
            assert bool(flags & LIGHT) >= told[-1][1]
            if not any(told[-1]):
                assert flags == 0
    n, n_motions = len(good), len(motions)
    assert not np.any(told[:n])
    is_moved, is_off = (np.array([t[k] for t in told[n:]]) for k in (0, 1))
    assert not is_moved[:3].any()  # 0.15 px
    assert is_moved[n_motions - 4 : len(moved)].all()  # from 0.32 px on
    assert is_off[[len(moved), -2, -1]].all()
