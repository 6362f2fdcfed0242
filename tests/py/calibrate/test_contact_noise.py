"""What counts as a touch: the stated rate of false alarms holds for newly drawn noise; what is no rest is refused."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from scipy.ndimage import gaussian_filter

from ruffini.errors import InputError
from ruffini.estimators.threshold.fit import ALLOWED_RATE, MIN_FRAMES, fit_contact_noise, largest_square

N_REST = 8
SHAPE = (12, 15)


def noise(seed: int, n: int) -> npt.NDArray[np.float64]:
    """Alike on neighbouring nodes, twice as loud at one end of the pad, 0.1 to 0.2 mN."""
    white = np.random.default_rng(seed).standard_normal((n, *SHAPE))
    smooth = gaussian_filter(white, (0, 1, 1), mode="wrap")
    return np.asarray(smooth / smooth.std() * np.linspace(1e-4, 2e-4, SHAPE[1]))


def live(seed: int, n: int) -> npt.NDArray[np.float64]:
    """Frames less the mean of the first ones, as the board has them."""
    frames = noise(seed, n + N_REST)
    return frames[N_REST:] - frames[:N_REST].mean(axis=0)


def test_the_stated_rate_holds_for_other_frames() -> None:
    fit = fit_contact_noise(live(1, 400), N_REST)
    n_frames = n_touched = n_nearly = 0
    for seed in range(100, 120):  # 200,000 frames in all, a rest image every 100
        frames = noise(seed, 10_000).reshape(100, 100, *SHAPE)
        rest = noise(1000 + seed, 100 * N_REST).reshape(100, N_REST, *SHAPE).mean(axis=1, keepdims=True)
        pressure = (frames - rest).reshape(-1, *SHAPE)
        square, alone = largest_square(pressure), pressure.max(axis=(1, 2))
        n_touched += int(((square > fit.square_n) | (alone > fit.alone_n)).sum())
        n_nearly += int(((square > 0.8 * fit.square_n) | (alone > 0.8 * fit.alone_n)).sum())
        n_frames += len(pressure)
    assert n_touched <= 3 * ALLOWED_RATE * n_frames
    assert n_nearly > 3 * ALLOWED_RATE * n_frames  # no larger than it must be


def test_one_node_needs_more_than_four() -> None:
    fit = fit_contact_noise(live(2, 200), N_REST)
    assert 3 * 2e-4 < fit.square_n < fit.alone_n < 8 * 2e-4
    assert fit.sigma_n.max() == pytest.approx(2e-4 * np.sqrt(1 + 1 / N_REST), rel=0.25)
    assert fit.tensors()["contact.noise_un"].tolist() == [int(np.ceil(v * 1e6)) for v in (fit.square_n, fit.alone_n)]


def test_a_touch_in_the_recording_is_refused() -> None:
    pressure = live(3, 200)
    pressure[150, 4:6, 4:6] += 4e-3
    with pytest.raises(InputError, match="frame 150 after rest"):
        fit_contact_noise(pressure, N_REST)


def test_a_few_frames_are_refused() -> None:
    with pytest.raises(InputError, match=f"at least {MIN_FRAMES}"):
        fit_contact_noise(live(4, 99), N_REST)


def test_one_picture_again_and_again_is_refused() -> None:
    with pytest.raises(InputError, match="live camera"):
        fit_contact_noise(np.repeat(live(5, 1), 200, axis=0), N_REST)
