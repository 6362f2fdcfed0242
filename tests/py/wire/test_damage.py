"""A line that damages frames often is said to be bad, one that does so rarely is not."""

from __future__ import annotations

import importlib.util
from pathlib import Path

from ruffini.wire.damage import INTERVAL_S, DamageWatch

BENCH = Path(__file__).parents[2] / "bench"


def test_one_damaged_frame_in_six_minutes_is_borne() -> None:
    watch = DamageWatch()
    for i in range(5):
        assert not watch.update(i + 1, i * INTERVAL_S)
        assert not watch.is_bad(i * INTERVAL_S)


def test_a_second_one_within_six_minutes_makes_the_line_bad_once_and_for_six_minutes() -> None:
    watch = DamageWatch()
    assert not watch.update(1, 100.0)
    assert watch.update(2, 100.0 + INTERVAL_S - 1)
    assert not watch.update(3, 100.0 + INTERVAL_S - 0.5)  # said already
    assert watch.is_bad(100.0 + 2 * INTERVAL_S - 2)
    assert not watch.is_bad(100.0 + 2 * INTERVAL_S)


def test_two_at_once_are_enough() -> None:
    assert DamageWatch().update(2, 0.0)


def test_a_new_decoder_counts_from_zero() -> None:
    watch = DamageWatch()
    assert not watch.update(1, 0.0)
    watch.begin_decoder()
    assert watch.update(1, 2.0)


def test_a_count_that_falls_is_no_damage() -> None:
    watch = DamageWatch()
    assert watch.update(3, 0.0)
    assert not watch.update(0, 3 * INTERVAL_S)
    assert not watch.is_bad(3 * INTERVAL_S)


def test_less_than_four_frames_in_a_billion_hours_are_wrong_before_the_line_is_called_bad() -> None:
    spec = importlib.util.spec_from_file_location("line_errors", BENCH / "line_errors.py")
    assert spec is not None
    assert spec.loader is not None
    line_errors = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(line_errors)
    assert 2e-9 < line_errors.believed_per_h() < 4e-9
    # 8.5e10 bits an hour, one in 1e9 of them flipped, 1.2 % of these of the structure, one in 4.3e9 of those unseen.
    assert 2e-10 < line_errors.at_bit_error_rate(1e-9) < 4e-10
    assert line_errors.at_bit_error_rate(1e-9) < 4e-9 < line_errors.at_bit_error_rate(1e-7)
