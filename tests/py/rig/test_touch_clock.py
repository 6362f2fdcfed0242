"""Clocks touch by touch: signals that lag a load, since rubber forgets, are not taken for a late camera."""

from __future__ import annotations

import numpy as np
import pytest

from ruffini.errors import InputError
from ruffini.rig.touch_clock import Pressed, fit_touches

FRAME_S, READING_S, LATE_S = 1 / 30, 1 / 30, 0.013


def touches(
    n: int, *, late_s: float, forgets: float, seed: int = 1, slower: float = 1.0, noise: float = 5e-4
) -> list[Pressed]:
    """Loads that rise and fall within three seconds; the sensor forgets a part of each within 0.3 s, and then more.

    `slower`: that many times as long, and frames and readings as far apart.
    """
    rng, out = np.random.default_rng(seed), []
    fine_s = np.arange(0.0, 3.0, 1e-3)
    for k in range(n):
        rise, hold = rng.uniform(0.4, 0.9), rng.uniform(0.2, 0.8)
        load = np.interp(fine_s, [0.3, 0.3 + rise, 0.3 + rise + hold, 2.9], [0.0, 1.0, 0.9, 0.0])
        moved = load.copy()
        for tau_s in (0.3, 3.0):
            h = np.zeros_like(load)
            for i in range(1, len(h)):
                h[i] = h[i - 1] + (1 - np.exp(-1e-3 * slower / tau_s)) * (load[i] - h[i - 1])
            moved += forgets * h
        frames, readings = (np.arange(0.02, 2.95, step) for step in (FRAME_S, READING_S))
        axes = np.array([0.3, -0.2, -5.0, 0.0, 0.0, 0.0])
        signals = np.interp(frames, fine_s, moved)[:, None] * rng.uniform(0.8, 1.2, 3)
        felt = np.interp(readings, fine_s, load)[:, None] * axes + rng.normal(size=(len(readings), 6)) * 2e-3
        start_s = 10.0 * slower * k
        out.append(Pressed(start_s + slower * frames, signals + rng.normal(size=signals.shape) * noise,
                           start_s + slower * readings + late_s, felt))  # fmt: skip
    return out


@pytest.mark.parametrize("forgets", [0.0, 0.1])
def test_the_offset_is_found_whether_or_not_rubber_forgets(forgets: float) -> None:
    fit = fit_touches(touches(12, late_s=LATE_S, forgets=forgets))
    assert fit.offset_s == pytest.approx(LATE_S, abs=1e-3)
    assert fit.offset_sigma_s < 1e-3
    assert fit.correlation > 0.999


def test_frames_that_are_far_apart_do_not_take_memory_for_a_late_camera() -> None:
    """At five frames a second the memory of 0.3 s cannot be told from a shift of as much: it is left out there."""
    fit = fit_touches(touches(12, late_s=LATE_S, forgets=0.0, slower=6.0, noise=2e-2))
    assert fit.offset_s == pytest.approx(LATE_S, abs=5e-3)


def test_signals_of_something_else_are_refused() -> None:
    wrong = touches(6, late_s=0.0, forgets=0.0)
    rng = np.random.default_rng(3)
    with pytest.raises(InputError, match="does not show what the stream shows"):
        fit_touches([t._replace(signals=rng.normal(size=t.signals.shape)) for t in wrong])
