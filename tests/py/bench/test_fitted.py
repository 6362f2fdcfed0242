"""The benchmark with a fitted material: what its figures mean."""

import numpy as np
import pytest

from ruffini.bench import fitted
from ruffini.bench.states import JUDGED
from ruffini.boards import find_board


def test_no_press_is_both_fitted_on_and_judged():
    assert not {touch for r in fitted.LOGGED for touch in r.touches} & {touch for r in JUDGED for touch in r.touches}


def test_noise_is_described_by_its_size_and_by_its_correlation_with_the_node_beside():
    rng = np.random.default_rng(1)
    white = rng.normal(size=(30, 25, 31, 3)) * [1e-6, 2e-6, 3e-6]
    white[:, :, 1::2, 2] = white[:, :, :-1:2, 2]  # two by two along x share their value
    described = fitted._describe(white)
    assert described["fields"] == 30
    np.testing.assert_allclose(described["sigma_um"], [1, 2, 3], rtol=0.05)
    assert described["beside"][0] == pytest.approx(0, abs=0.03)
    assert described["beside"][2] == pytest.approx(0.5, abs=0.05)


def test_only_boards_with_dots_and_colours_have_a_noise_to_measure():
    board = find_board("gelslim")
    assert fitted.has_images(board)
    blind = board.pipeline.model_copy(update={"stages": ["difference", "operator"]})
    assert not fitted.has_images(board.model_copy(update={"pipeline": blind}))


def test_the_table_says_what_was_measured_and_what_is_wanted():
    row = {"mean_n": 0.0035, "within": 98.0, "worst": 1.04, "frames": 12}
    text = fitted.table({
        "noise": {"sigma_um": [1.0, 1.1, 2.5], "beside": [0.5, 0.5, 0.9], "fields": 40}, "wanted": [0.02, 0.03],
        "pads": [[-2.4, -1.3, -2.6]], "rows": {"fitted": row},
    })  # fmt: skip
    assert all(part in text for part in ("1.0/1.1/2.5 um", "-2.4 %, -1.3 %, -2.6 %", "3.5 mN", "98 %", "1.04"))
