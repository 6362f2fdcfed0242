"""Two fingers on eltac's tube: how many of the frames tell both, of each distance and direction."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from papers.eltac.experiment import RESOLVED_MM, _two_fingers, fingers

PLACE_MM = np.array([10.0, 20.0])


def pressed(name: str, distance_um: int, turn_mrad: int, off_mm: list[float], load_n: float = 3.0) -> Any:
    """A press whose frames tell the fingers; the second one off along the tube by so much in each frame."""
    second = SimpleNamespace(radius_um=5000, distance_um=distance_um, turn_mrad=turn_mrad)
    run = SimpleNamespace(settings=SimpleNamespace(second=second))
    p = SimpleNamespace(name=name, recorded=SimpleNamespace(run=run), place=PLACE_MM)
    way_m = 2e-3
    p.touches = [np.array(fingers(p, way_m)) + np.array([[0.0, 0.0], [0.0, off]]) for off in off_mm]
    p.load, p.way = np.full(len(off_mm), load_n), np.full(len(off_mm), way_m)
    return p


def test_each_distance_and_direction_has_its_own_share() -> None:
    beyond = RESOLVED_MM + 0.1
    played = [
        pressed("judge_two_round_20", 20_000, 0, [0.0, beyond]),
        pressed("judge_two_round", 15_000, 0, [0.0, 0.0, beyond, 0.0]),
        pressed("judge_two_round", 15_000, 0, [beyond] * 4),
        pressed("judge_two_along", 15_000, 1571, [0.0]),
        pressed("judge_two_along", 15_000, 1571, [beyond], load_n=1.0),  # too light to count
        pressed("judge_force", 15_000, 0, [beyond]),
    ]
    found = {"15 mm, along": 1.0, "15 mm, round": 3 / 8, "20 mm, round": 0.5}
    assert _two_fingers(played) == pytest.approx(found)


def test_one_touch_in_their_middle_or_a_third_one_is_not_both() -> None:
    one, three = (pressed("judge_two_round", 15_000, 0, [0.0]) for _ in range(2))
    one.touches = [PLACE_MM[None, :]]
    three.touches = [np.vstack([three.touches[0], PLACE_MM])]
    assert _two_fingers([one]) == _two_fingers([three]) == {"15 mm, round": 0.0}


def test_a_press_that_was_too_light_has_no_figure() -> None:
    assert _two_fingers([pressed("judge_two_round", 15_000, 0, [0.0], load_n=1.0)]) == {}
