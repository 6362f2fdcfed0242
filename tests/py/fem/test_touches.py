"""Simulated touches: what they promise the error model's fit."""

from __future__ import annotations

import numpy as np

from ruffini.fem.condense import condense, surface_stiffness
from ruffini.fem.slab import Slab
from ruffini.fem.touches import DEPTH_M, MaterialSpread, TouchMaker
from ruffini.reflection import dense_from_blocks, spd_inverse

SLAB = Slab(16e-3, 12e-3, 4e-3, 17, 13, 4, 2e5, 0.48)


def test_pushes_as_deep_as_asked_for_and_never_pulls() -> None:
    maker = TouchMaker(SLAB, 3)
    for _ in range(12):
        touch = maker.draw()
        assert DEPTH_M[0] * 0.999 <= -touch.displacement[..., 2].min() <= DEPTH_M[1] * 1.001
        assert touch.force[..., 2].max() <= 0
        shear = np.linalg.norm(touch.force[..., :2], axis=-1)
        assert (shear <= -touch.force[..., 2] * 1.01 + 1e-12).all()
        assert not touch.force[[0, -1]].any()  # nothing hangs over the sides
        assert not touch.force[:, [0, -1]].any()


def test_is_the_pads_own_compliance_up_to_what_elements_get_wrong() -> None:
    condensed = condense(SLAB)
    pad = dense_from_blocks(condensed.bases, [spd_inverse(b) for b in surface_stiffness(condensed)])
    maker = TouchMaker(SLAB, 5)
    for _ in range(6):
        touch = maker.draw()
        by_elements = (pad @ touch.force.ravel()).reshape(touch.force.shape)
        apart = np.linalg.norm(by_elements - touch.displacement) / np.linalg.norm(touch.displacement)
        assert 0.003 < apart < 0.3  # nothing at all would be the board's own model


def test_same_seed_same_touches_and_a_stiffer_pad_pushes_back_more() -> None:
    first, again = TouchMaker(SLAB, 7).draw(), TouchMaker(SLAB, 7).draw()
    np.testing.assert_array_equal(first.force, again.force)
    assert np.abs(first.force - TouchMaker(SLAB, 8).draw().force).max() > 0
    spread = TouchMaker(SLAB, 7, modulus_spread=0.1).draw()
    np.testing.assert_array_equal(first.displacement, spread.displacement)
    ratio = spread.force.sum() / first.force.sum()
    assert 0.75 <= ratio <= 1.25
    assert ratio != 1


def test_the_pads_have_the_spread_that_they_say() -> None:
    pads = MaterialSpread(poisson=0.01, thickness=0.02).pads(SLAB)
    poisson = np.array([p.poisson for p in pads]) / SLAB.poisson - 1
    thickness = np.array([p.thickness_m for p in pads]) / SLAB.thickness_m - 1
    np.testing.assert_allclose([poisson.std(), thickness.std()], [0.01, 0.02], rtol=1e-9)
    np.testing.assert_allclose([poisson.mean(), thickness.mean()], 0, atol=1e-12)
