"""One factor adapts a colour table to the next gel, with a handful of presses or one."""

from __future__ import annotations

import numpy as np
import pytest

from ruffini.estimators.photometric.fit import Samples
from ruffini.estimators.photometric.scale import fit_scale, scaled

TRUE = 1.12  # the next gel answers weaker: the table's normals must grow


def tables(*, has_bend: bool) -> dict[str, np.ndarray]:
    unmix = np.zeros((13, 17, 2, 3), np.int16)
    unmix[..., 0, 0] = unmix[..., 1, 1] = 6000
    axis = np.linspace(-1, 1, 65)
    q_y, q_x = np.meshgrid(axis, axis, indexing="ij")
    length = np.minimum(np.hypot(q_x, q_y), 0.97)
    slope = np.stack([q_x, q_y], axis=2) / np.sqrt(1 - length**2)[..., None]
    out = {"photometric.unmix": unmix, "photometric.slope": np.clip(slope * 4096, -32767, 32767).astype(np.int16)}
    if has_bend:
        out["photometric.bend"] = np.full((9, 9, 9, 2), 300, np.int16)
        out["photometric.bend_axis"] = np.array([[-4096] * 3, [10] * 3], np.int32)
    return out


def presses(n: int, *, offset: float) -> list[Samples]:
    """Pixels under balls, as the table `tables` sees them on a gel that is weaker by TRUE."""
    rng = np.random.default_rng(2)
    out = []
    for _ in range(n):
        q = rng.uniform(-0.4, 0.4, (400, 2))
        change = np.column_stack([(q / TRUE - offset) * 4096 / 6000, np.zeros(400)]) + rng.normal(0, 0.005, (400, 3))
        slope = q / np.sqrt(1 - (q**2).sum(axis=1, keepdims=True))
        out.append(Samples(change, rng.uniform(-1, 1, (400, 2)), slope, 0 * q, np.zeros(3), 50.0, 100.0))
    return out


@pytest.mark.parametrize("has_bend", [False, True])
def test_the_factor_is_found_and_the_prior_holds_a_single_press(has_bend: bool) -> None:
    table, offset = tables(has_bend=has_bend), 300 / 16384 if has_bend else 0.0
    scale, sigma, before_deg, after_deg = fit_scale(table, presses(6, offset=offset))
    assert scale == pytest.approx(TRUE, abs=0.02)
    assert after_deg < 0.3 * before_deg
    one, one_sigma, *_ = fit_scale(table, presses(1, offset=offset))
    assert 1 < one < scale + 0.01
    assert sigma < one_sigma < 0.1
    grown = scaled(table, scale)
    assert grown["photometric.unmix"].max() == round(6000 * scale)
    assert fit_scale(grown, presses(6, offset=offset))[0] == pytest.approx(1.0, abs=0.02)
