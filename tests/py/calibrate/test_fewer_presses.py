"""What fewer presses would have been worth: never judged on what was fitted, and said where nothing can be."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from ruffini.boards import find_board
from ruffini.calibrate import container
from ruffini.calibrate.report.fewer_presses import LEAST_JUDGED, accuracy_in, accuracy_of_presses, accuracy_text, draws
from ruffini.errors import InputError


@pytest.mark.parametrize("is_shuffled", [True, False])
def test_no_press_is_fitted_and_judged(is_shuffled: bool) -> None:
    made = list(draws(23, (5, 20, 21), 4, is_shuffled=is_shuffled))
    assert [size for size, *_ in made] == [5] * 4 + [20] * 4  # of 21, two would be left
    for size, used, left in made:
        assert len(used) == size
        assert len(left) >= LEAST_JUDGED
        assert sorted([*used, *left]) == list(range(23))
        if not is_shuffled:
            assert set(np.diff(used)) <= {1, -22}


def test_an_error_is_the_root_mean_square_of_its_draws() -> None:
    said = iter([3.0, 4.0, 5.0])
    (row,) = accuracy_of_presses(10, lambda used, left: {"place_error_mm": next(said)})
    assert row == {"presses": 5, "place_error_mm": pytest.approx(np.sqrt(50 / 3))}
    assert accuracy_text(row) == "  5 presses: place by 4.08 mm"


def test_presses_that_tell_nothing_say_why() -> None:
    def error(used, left):
        if len(used) < 10:
            raise InputError("only 5 loads: more are needed")
        return {"error_percent": 2.0}

    rows = accuracy_of_presses(13, error)
    assert rows == [{"presses": 5, "why_not": "only 5 loads: more are needed"}, {"presses": 10, "error_percent": 2.0}]
    assert accuracy_text(rows[0]) == "  5 presses: only 5 loads: more are needed"


def test_a_file_keeps_them() -> None:
    file = container.pack({}, container.base_metadata(find_board("gelslim")))
    assert accuracy_in(file, "skin") == []
    rows = [{"presses": 5, "place_error_mm": 1.5}]
    for said in ({"accuracy_of_presses": rows}, {"stages": {"skin": {"accuracy_of_presses": rows}}}):
        kept = replace(file, metadata={**file.metadata, "residuals": json.dumps(said)})
        assert accuracy_in(kept, "skin") == rows
    assert accuracy_in(replace(file, metadata={"residuals": "[1"}), "skin") == []
