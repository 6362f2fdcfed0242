"""A glowing skin's calibration on presses whose law is known."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from kept import kept

from ruffini.boards import find_board
from ruffini.errors import InputError
from ruffini.estimators.skin.gain import fit_gain, no_gain
from ruffini.estimators.skin.openings import TubeView, find_openings, fit_view, lattice_mm
from ruffini.estimators.skin.places import errors, fit_places
from ruffini.estimators.skin.presses import Press, inward, out_of
from ruffini.estimators.skin.reach import fit_reach, stands_out, unexplained
from ruffini.estimators.skin.response import TIMES_S, Layout, Memory, fit_force, layout_of
from ruffini.estimators.skin.rubber import pyramid_force

BOARD = next(b for b in map(find_board, ("eltac",)) if b.skin is not None)
LENS = TubeView(950.0, 160.0, -0.3, 0.2, 647.6, 357.5, 40.0, 0.0)
PARTS = (0.2, 0.1, 0.15, 0.1)
A, B, SCALE = 0.5, 0.12, 4.0
SHIFT_MM = np.array([0.5, -0.4])


def press(place: npt.NDArray[np.float64], strength: float, rng: np.random.Generator, layout: Layout) -> Press:
    """Down and up in 24 frames: sinks fall off by cusps, force by the rubber's law with memory."""
    time_s = np.arange(34) / 30.0
    way = np.concatenate([np.zeros(10), np.linspace(0.1, 1, 12), np.linspace(1, 0.1, 12)]) * strength
    off = np.abs(layout.away(place - SHIFT_MM))
    u = way[:, None] * np.exp(-off[:, 0] / 8 - off[:, 1] / 15)
    each = SCALE * (pyramid_force(A * u + B) - pyramid_force(np.array(B)))
    total = np.where(u > 0.02, each, 0).sum(axis=1)
    force = total - np.array(PARTS) @ Memory.of([time_s]).of_load(total)
    ratio = np.expm1(u) + rng.normal(0, 0.003, u.shape)
    return Press("made", time_s, force, place, ratio)


def test_a_lens_is_found_from_points() -> None:
    rng = np.random.default_rng(1)
    place = np.column_stack([rng.uniform(-120, 120, 40), rng.uniform(-55, 55, 40)])
    points = np.column_stack([LENS.project(place), place[:, 1]])
    found = fit_view(BOARD, points + rng.normal(0, 0.2, points.shape) * [1, 1, 0])
    assert found.rmse_px < 0.4
    assert np.abs(found.project(place) - LENS.project(place)).max() < 0.6
    assert np.abs(found.unproject(found.project(place)) - place).max() < 1e-3
    with pytest.raises(InputError, match="known points"):
        fit_view(BOARD, points[:5])
    for shape in ("plane", "dome"):
        assert BOARD.skin is not None
        other = BOARD.model_copy(update={"skin": BOARD.skin.model_copy(update={"shape": shape})})
        with pytest.raises(InputError, match=f"is a {shape}, but known points say heights along a tube"):
            fit_view(other, points)


def test_openings_are_found_and_those_in_the_wrong_place_refused() -> None:
    guess = LENS.project(lattice_mm(BOARD))
    picture = np.zeros((720, 1280))
    for x, y in np.round(guess).astype(int):
        picture[y - 2 : y + 3, x - 2 : x + 3] = 80
    openings = find_openings(BOARD, picture, guess)
    light = openings.light(picture)
    assert openings.n_taxels == len(guess)
    assert light.sum() == picture.sum()
    assert openings.n_patches > 10
    with pytest.raises(InputError, match="openings"):
        find_openings(BOARD, picture, guess + 300)


def test_each_press_remembers_from_its_own_first_frame() -> None:
    rng = np.random.default_rng(4)
    times_s = [np.cumsum(rng.uniform(0.02, 0.05, n)) for n in (7, 3, 5)]
    load = rng.uniform(0, 5, 15)
    found, row = Memory.of(times_s).of_load(load), 0
    for time_s in times_s:
        h = np.zeros(4)
        assert (found[:, row] == 0).all()
        for i in range(1, len(time_s)):
            mean = (load[row + i] + load[row + i - 1]) / 2
            h = mean + (h - mean) * np.exp(-(time_s[i] - time_s[i - 1]) / np.array(TIMES_S))
            assert found[:, row + i] == pytest.approx(h)
        row += len(time_s)


def test_force_and_place_of_presses_that_were_not_fitted() -> None:
    rng = np.random.default_rng(2)
    layout = layout_of(BOARD, lattice_mm(BOARD))
    place = np.column_stack([rng.uniform(-110, 110, 60), rng.uniform(-54, 54, 60)])
    presses = [press(p, rng.uniform(0.7, 1.3), rng, layout) for p in place]
    fitted, judged = presses[:48], presses[48:]
    force, places = kept(fit_force, fitted, layout), kept(fit_places, fitted, layout)
    found = errors(judged, layout, force, places)
    load, off, away = found.load_n, found.off_n, found.away_mm
    assert len(load) > 60
    assert np.mean(np.abs(off / load)[load > 1.5]) < 0.04
    assert np.mean(away) < 1.2
    moved = places.places_mm - layout.places_mm
    assert np.abs(moved.mean(axis=0) - SHIFT_MM).max() < 0.35
    reach = kept(fit_reach, fitted, layout, places)
    assert reach[0, 0] == 1.0
    assert (np.diff(reach, axis=0) <= 0).all()
    assert unexplained(judged, layout, places, reach) < 0.5


def test_force_into_a_curved_skin() -> None:
    skin = BOARD.skin
    assert skin is not None
    out = out_of(skin, np.array([np.pi * 20, 3.0]))  # a quarter round
    assert np.allclose(out, [0, 1, 0], atol=1e-9)
    assert np.allclose(inward(skin, np.array([[0, -2.0, 0, 0, 0, 0]]), np.array([np.pi * 20, 3.0])), 2.0)


def test_a_gain_that_changes_with_place_load_and_rim_is_found() -> None:
    rng = np.random.default_rng(3)
    n = 600
    kind, q = rng.integers(0, 6, n), rng.uniform(-1, 1, (n, 2))
    elastic = np.exp(rng.uniform(np.log(0.5), np.log(12), n))

    def true(kind: npt.NDArray[np.int64], elastic: npt.NDArray[np.float64], q: npt.NDArray[np.float64]) -> Any:
        return np.where(kind < 3, 1 + 0.2 * q[:, 0] ** 2, 0.8 + 0.3 * np.abs(q[:, 1])) * (1 + 0.01 * elastic)

    press = np.arange(n) // 6
    force = elastic * true(kind, elastic, q) * np.exp(rng.normal(0, 0.02, n))
    gain = fit_gain(kind, elastic, q, force, press)
    kind, q, elastic = rng.integers(0, 6, 300), rng.uniform(-0.9, 0.9, (300, 2)), rng.uniform(0.6, 10, 300)
    off = gain.at(kind, elastic, q) / true(kind, elastic, q) - 1
    assert np.abs(off).mean() < 0.02
    assert np.abs(no_gain().at(kind, elastic, q) / true(kind, elastic, q) - 1).mean() > 0.08


def test_a_tail_does_not_stand_out_and_a_finger_does() -> None:
    layout = layout_of(BOARD, lattice_mm(BOARD))
    off = np.abs(layout.away(np.array([15.7, -5.0])))
    u = np.exp(-off[:, 0] / 8) * np.exp(-off[:, 1] / 60)
    peak, tail = int(off.sum(axis=1).argmin()), int(np.abs(off - [0, 30]).sum(axis=1).argmin())
    assert stands_out(u, layout)[peak]
    assert not stands_out(u, layout)[tail]
