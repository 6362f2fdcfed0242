"""Deviations that a skin states, from errors whose spread is known."""

from __future__ import annotations

import numpy as np
import pytest

from ruffini.estimators.skin.spread import Errors, spread_by_kind, spread_of

THRESHOLD_N, N_KINDS = 0.6, 6
INSIDE, SEAM, RIM = 0.05, 0.15, 0.18  # of the force
PLACE_MM, FAINT_MM = 0.4, 0.9


def made(n_presses: int, kinds: dict[int, float], seed: int = 3) -> Errors:
    """Presses of 40 frames, each on one kind of taxel, whose force errs by 0.05 N and by a part of the force."""
    rng, parts = np.random.default_rng(seed), []
    for number in range(n_presses):
        kind, part = list(kinds.items())[number % len(kinds)]
        load = rng.uniform(0.8, 9.0, 40)
        off = rng.normal(0, np.hypot(0.05, part * load))
        off_mm = rng.normal(0, (PLACE_MM + FAINT_MM * THRESHOLD_N / load)[:, None], (40, 2))
        parts.append(Errors(load, off, off_mm, np.full(40, kind), np.full(40, number)))
    return Errors.joined(parts)


def test_the_parts_of_a_deviation_are_found_and_none_counts_twice() -> None:
    found = spread_of(made(200, {1: 0.05}), THRESHOLD_N)
    assert found.force_n == pytest.approx(0.05, rel=0.25)
    assert found.force_part == pytest.approx(0.05, rel=0.05)
    assert found.place_mm == pytest.approx(PLACE_MM, rel=0.06)
    assert found.faint_place_mm == pytest.approx(FAINT_MM, rel=0.15)


def test_two_deviations_cover_95_percent_inside_beside_seams_and_at_rims() -> None:
    kinds = {0: SEAM, 1: INSIDE, 2: INSIDE, 3: RIM, 4: RIM, 5: RIM}
    stated, other = spread_by_kind(made(90, kinds), THRESHOLD_N, N_KINDS), made(90, kinds, seed=8)
    for kind in kinds:
        rows, own = other.of(other.kind == kind), stated[kind]
        over = np.abs(rows.off_n) / np.hypot(own.force_n, own.force_part * rows.load_n)
        assert 0.92 < np.mean(over < 2) < 0.98, kind
        assert 0.60 < np.mean(over < 1) < 0.76, kind


def test_a_zone_that_few_presses_tell_of_has_the_deviation_of_all() -> None:
    errors = made(32, {1: INSIDE, 4: RIM})
    few = errors.of((errors.kind == 1) | (errors.press < 4))  # two presses at a rim
    stated = spread_by_kind(few, THRESHOLD_N, N_KINDS)
    assert stated[4] == spread_of(few, THRESHOLD_N)
    assert stated[0][:2] == stated[4][:2]  # none is beside a seam
    assert stated[2].force_part == pytest.approx(INSIDE, rel=0.15)
