"""Newtons of the pictures that libcamera's virtual pipeline played, beside the twin's truth. SIMULATED."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from typing import Any

import numpy as np

MAX_ERROR = 0.05  # of the largest force: the gate of `make run`
MAX_UNTOUCHED = 0.02  # newtons
MAX_AWAY = 3.0  # grey levels, mean over a picture; without tests/vm/prepare.py's own conversion they are 6.4


def beside_truth(frames: Iterable[tuple[Any, Any, bool]]) -> str:
    """What the errors are of (Image, Wrench, is it marked as simulated), until each touch of prepare.py was seen.

    Which picture a frame shows is told by the picture itself.
    """
    from ruffini.device.results import VALID

    truth = np.load("/vm/truth.npz")
    wrench, thinned = truth["wrench"], np.s_[..., ::2, ::2, :]  # a quarter of the pixels tells one picture from another
    played = truth["pictures"][thinned].astype(np.int16)
    pressed = set(np.flatnonzero(wrench[:, 2]).tolist())
    n_told = int(truth["n_told"])  # pictures of the story, which is told several times
    moments = {k % n_told for k in pressed}
    answers: list[tuple[int, Any]] = []  # number of the picture, newtons
    away = []  # of the pictures as the host gets them, grey levels
    for image, said, is_simulated in itertools.islice(frames, 250):
        levels = np.abs(played - image.pixels[thinned]).mean(axis=(1, 2, 3))
        k = int(levels.argmin())
        away.append(float(levels[k]))
        assert is_simulated
        if said.validity == (VALID,) * 6:
            answers.append((k, said.values[:3]))
        if moments <= {k % n_told for k, _ in answers}:
            break
    missing = sorted(moments - {k % n_told for k, _ in answers})
    assert not missing, f"in {len(away)} frames, pictures without a valid wrench: {missing}"
    errors = np.array([np.linalg.norm(newtons - wrench[k, :3]) for k, newtons in answers if k in pressed])
    untouched = [np.linalg.norm(newtons) for k, newtons in answers if k not in pressed]
    largest = np.linalg.norm(wrench[:, :3], axis=1).max()
    found = (
        f"{len(away)} frames, {len(errors)} of them touches of up to {largest:.2f} N: error {np.median(errors):.3f} N "
        f"(median), {np.percentile(errors, 95):.3f} (95 %), {errors.max():.3f} (largest); {max(untouched):.3f} N in "
        f"{len(untouched)} untouched ones; pictures {max(away):.1f} grey levels from the twin's\n"
        + "\n".join(
            f"{k:2d}: {newtons.round(3)} N, true {wrench[k, :3].round(3)}"
            for k, newtons in sorted(dict(answers).items())
            if k in pressed
        )
    )
    assert max(away) < MAX_AWAY, found
    assert np.percentile(errors, 95) < MAX_ERROR * largest, found
    assert max(untouched) < MAX_UNTOUCHED, found
    return found
