"""The benchmark of a window smaller than the pad: what it cuts, and what it finds."""

import numpy as np

from ruffini.bench import window
from ruffini.boards import find_board


def test_a_narrowed_board_sees_less_and_is_otherwise_the_same():
    board = find_board("gelslim")
    part = window.narrowed(board)
    rows, columns = part.observed
    assert (rows, columns) == (slice(5, 20), slice(5, 26))  # 3 mm are 4.5 node steps
    assert part.model_dump(exclude={"window"}) == board.model_dump(exclude={"window"})


def test_the_table_says_what_was_judged():
    row = {
        "tangential": 0.3, "normal": 0.1, "resultant_n": 0.0123, "raw_resultant_n": 0.4, "says_so": 0.75,
        "wrench_within_1": 70.0, "wrench_within_2": 95.0, "frames": 8,
    }  # fmt: skip
    text = window.table({"margin_mm": 3.0, "noise_um": (5, 5, 20), "rows": {"across": row}})
    assert all(part in text for part in ("12.3 mN", "400 mN", "75 %", "70, 95 %"))


def test_relative_error_of_a_component_that_is_next_to_nothing_is_against_the_whole_force():
    true = np.zeros((2, 2, 3))
    true[..., 2] = -1.0
    error = np.zeros_like(true)
    error[0, 0, 0] = 0.01
    assert np.isclose(window._relative(error, true, slice(0, 2)), 0.01 / (0.05 * 2.0))
