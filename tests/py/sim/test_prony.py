"""Relaxation: the recursion against the integral that it stands for."""

import numpy as np
import pytest

from ruffini.errors import InputError
from ruffini.sim.prony import Memory, Prony

SERIES = Prony(((0.15, 0.3), (0.1, 4.0)))


def kernel(t):
    raw = 1 - 0.15 * (1 - np.exp(-t / 0.3)) - 0.1 * (1 - np.exp(-t / 4.0))
    return raw / (1 - 0.15 * (1 - np.exp(-1 / 0.3)) - 0.1 * (1 - np.exp(-1 / 4.0)))


def stresses(memory, path):
    out = []
    for duration_s, elastic in path:
        memory.begin(duration_s)
        out.append(float(memory.factor * elastic + memory.held))
        memory.commit(np.array(elastic))
    return out


def test_a_sudden_strain_relaxes_as_the_series_says():
    got = stresses(Memory(SERIES), [(0.0, 2.0), (0.5, 2.0), (0.5, 2.0), (100.0, 2.0)])
    np.testing.assert_allclose(got, 2 * kernel(np.array([0, 0.5, 1.0, 101.0])), rtol=1e-12)
    assert got[1] == pytest.approx(2 * SERIES.part(0.5), rel=1e-12)
    assert got[2] == pytest.approx(2.0)  # the board's modulus is what shows after a second
    assert 1 - got[3] / got[0] == pytest.approx(SERIES.loss)


@pytest.mark.parametrize("n_steps", [1, 7])
def test_an_even_ramp_is_exact_in_any_number_of_steps(n_steps):
    """int_0^T g(T - s) ds / T by fine quadrature."""
    end_s = 1.7
    s = (np.arange(200_000) + 0.5) * end_s / 200_000
    expected = kernel(end_s - s).mean()
    got = stresses(Memory(SERIES), [(end_s / n_steps, (i + 1) / n_steps) for i in range(n_steps)])
    assert got[-1] == pytest.approx(expected, rel=1e-9)


def test_after_release_the_stress_turns_and_fades():
    got = stresses(Memory(SERIES), [(0.0, 1.0), (2.0, 1.0), (0.0, 0.0), (0.3, 0.0), (60.0, 0.0)])
    assert got[2] < got[3] < got[4] < 0
    assert got[4] > -1e-6


def test_without_terms_nothing_is_remembered():
    assert stresses(Memory(Prony()), [(1.0, 3.0), (1.0, 0.0)]) == [3.0, 0.0]


def test_a_rubber_cannot_lose_all_its_stress():
    with pytest.raises(InputError, match="sum below 1"):
        Prony(((0.6, 1.0), (0.4, 2.0)))
