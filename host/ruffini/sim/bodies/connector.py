"""Loads by hand through a rigid connector in the pad's place: the 17 conditions of the F-TOUCH paper's Table II."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ruffini.sim.programs import Load, Rest, Step

Array = npt.NDArray[np.float64]

# Signs of Fx Fy Fz Tx Ty Tz. The last one is twisted both ways.
CONDITIONS = np.array(
    [
        [0, 0, -1, 0, -1, 0], [0, 0, -1, -1, -1, 0], [0, 0, -1, -1, 0, 0], [0, 0, -1, -1, 1, 0],
        [0, 0, -1, 0, 1, 0], [0, 0, -1, 1, 1, 0], [0, 0, -1, 1, 0, 0], [0, 0, -1, 1, -1, 0],
        [0, 1, 0, 1, 0, 0], [1, 1, 0, 1, -1, 0], [1, 0, 0, 0, -1, 0], [1, -1, 0, -1, -1, 0],
        [0, -1, 0, -1, 0, 0], [-1, -1, 0, -1, 1, 0], [-1, 0, 0, 0, 1, 0], [-1, 1, 0, 1, 1, 0],
        [0, 0, 0, 0, 0, 1],
    ],
    dtype=float,
)  # fmt: skip
RANGES = np.array([1.0, 1.0, 8.0, 20e-3, 20e-3, 20e-3])  # N, N m: Table III, of the sensor
LEAST = 0.5  # of the largest peak: the smallest
TREMOR = 0.04  # of the peak: how unsteady a hand is, standard deviation
TREMOR_FRAMES = 4.0  # over which it changes


def hand_load(signs: Array, n_frames: int, rng: np.random.Generator, largest: Array = RANGES) -> Array:
    """Wrench in every frame of one push and release by hand, peaks up to `largest` (6,): (n_frames, 6) N and N m."""
    peaks = signs * largest * rng.uniform(LEAST, 1.0, 6)
    push = np.sin(np.pi * (np.arange(n_frames) + 1) / n_frames) ** 2
    white = rng.standard_normal((n_frames, 6))
    keep = np.exp(-1 / TREMOR_FRAMES)
    tremor = np.empty_like(white)
    tremor[0] = white[0]
    for i in range(1, n_frames):
        tremor[i] = keep * tremor[i - 1] + np.sqrt(1 - keep**2) * white[i]
    return np.asarray(push[:, None] * peaks * (1 + TREMOR * tremor))


def connector(n_rest: int, n_frames: int, rng: np.random.Generator) -> list[Step]:
    """All conditions one after the other, `n_frames` each; every frame of a load is judged."""
    story: list[Step] = [Rest(n_rest)]
    for signs in CONDITIONS:
        story += [Load(hand_load(signs, n_frames, rng), [True] * n_frames), Rest(2)]
        if signs[5]:
            story += [Load(hand_load(-signs, n_frames, rng), [True] * n_frames), Rest(2)]
    return story
