"""Presses of a log whose indenters were changed, as `cal fit --only contact` fits them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ruffini.boards import Board, find_board
from ruffini.errors import InputError
from ruffini.estimators.contact_model.touches import felt_after_mm, presses_of_log
from ruffini.rig.log_file import Log, TouchRecord, write_log

N_X, N_Y, N = 34, 26, 30
MIDDLE_MM = (1.5, -1.0)
HIDDEN_MM = 0.3  # of a ball's way, until it was felt


@pytest.fixture(scope="module")
def board() -> Board:
    return find_board("contact-glitter")


def touch(shape: str, shore_a: float) -> TouchRecord:
    """Pressed at 1 mm/s, standing still after each tenth; the flow goes outwards from MIDDLE_MM."""
    time_s = np.arange(N) * 0.1
    way_mm = np.repeat(np.arange(N // 2) * 0.1, 2)
    depth = way_mm + (HIDDEN_MM if shape == "sphere" else 0.0)
    x, y = np.arange(N_X) - (N_X - 1) / 2 - MIDDLE_MM[0], np.arange(N_Y) - (N_Y - 1) / 2 - MIDDLE_MM[1]
    away = np.stack(np.meshgrid(x, y), axis=-1)
    bell = np.exp(-(away**2).sum(axis=-1, keepdims=True) / 18.0) * away * 0.15
    force = np.zeros((N, 6))
    force[:, 2] = -3.0 * (depth**1.5 if shape == "sphere" else depth)
    place = np.column_stack([np.zeros((N, 2)), -1e-3 * way_mm])
    facts = {"kind": "indent", "session": "1", "contact_z_m": 0.0, "held_host_s": 0.0, "touched_host_s": 0.0,
             "lifted_host_s": time_s[-1] + 1,
             "tool": {"shape": shape, "radius_m": 5e-3, "shore_a": shore_a}}  # fmt: skip
    return TouchRecord(facts, {
        "stream_s": time_s, "stream_host_s": time_s, "stream_frame": np.arange(N),
        "stream_flags": np.where(time_s == 2.0, 8, 0),
        "stream_wrench": np.full((N, 6), np.nan), "stream_validity": np.zeros((N, 6), int),
        "reference_s": time_s, "reference_wrench": force, "stage_s": time_s, "stage_place": place, "marker_s": time_s,
        "marker_displacement": (bell.reshape(1, -1, 2) * depth[:, None, None]).astype(np.float32),
    })  # fmt: skip


def test_what_the_bench_knows_of_each_press(board: Board, tmp_path: Path) -> None:
    write_log(tmp_path / "log.h5", Log({"board": board.name}, [touch("flat", 60.0), touch("sphere", 30.0)]))
    flat, ball = presses_of_log(tmp_path / "log.h5", board)
    assert (flat.shape, flat.radius_mm, flat.shore_a) == ("flat", 5.0, 60.0)
    for press, first_mm in ((flat, 0.1), (ball, HIDDEN_MM)):
        assert press.goes_down
        assert press.travel_mm[0] == pytest.approx(first_mm, abs=0.02)  # a ball was felt late
        assert np.diff(press.travel_mm) == pytest.approx(0.1, abs=1e-6)  # where the stage stood still is left out
        assert press.center_um[-1] == pytest.approx(np.array(MIDDLE_MM) * 1e3, abs=60)
        assert press.size[-1] > 16 * 50
        assert (~press.is_good).sum() == 1  # its patches were lost
        assert press.surface_mm is None  # nobody measures it
        assert np.isnan(press.gel_mm).all()
    assert ball.force[-1, 2] == pytest.approx(-3.0 * 1.7**1.5, rel=1e-6)


def test_where_a_force_began() -> None:
    way = np.linspace(0, 1.5, 16)
    assert felt_after_mm("flat", way, -4 * (way + 0.1)) == pytest.approx(0.1, abs=1e-6)
    assert felt_after_mm("sphere", way, -2 * (way + 0.4) ** 1.5) == pytest.approx(0.4, abs=1e-6)
    assert felt_after_mm("sphere", way, 0 * way) == 0.0  # nothing was felt
    assert felt_after_mm("flat", way[:2], -way[:2]) == 0.0


def test_a_log_without_indenters_or_of_another_board_is_refused(board: Board, tmp_path: Path) -> None:
    one = touch("flat", 60.0)
    del one.facts["tool"]
    write_log(tmp_path / "bare.h5", Log({"board": board.name}, [one]))
    with pytest.raises(InputError, match="known shape and hardness"):
        presses_of_log(tmp_path / "bare.h5", board)
    write_log(tmp_path / "other.h5", Log({"board": "gelslim"}, [touch("flat", 60.0)]))
    with pytest.raises(InputError, match="collected on board 'gelslim'"):
        presses_of_log(tmp_path / "other.h5", board)
