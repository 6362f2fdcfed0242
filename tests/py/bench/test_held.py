"""The benchmark of held touches: what is judged is held, and what is logged is not judged."""

import pytest
from twinless import board_without_twin

from ruffini.bench import held
from ruffini.boards import find_board
from ruffini.errors import InputError
from ruffini.sim.programs import Rest, Touch


def test_only_frames_of_touches_at_their_full_depth_are_judged():
    steps = held.story(held.JUDGED)
    touches = [step for step in steps if isinstance(step, Touch)]
    assert len(touches) == len(held.JUDGED) == sum(isinstance(step, Rest) for step in steps) - 1
    for step, wanted in zip(touches, held.JUDGED, strict=True):
        judged = [pose for pose, is_judged in zip(step.poses, step.judged, strict=True) if is_judged]
        assert len(judged) == round(wanted.seconds * held.RATE_HZ)
        assert {pose.depth_m for pose in judged} == {wanted.depth * held.MM}
        assert all(pose != judged[0] for pose in step.poses[: held.RAMP_FRAMES - 1])


def test_no_touch_is_both_logged_and_judged():
    assert not set(held.LOGGED) & set(held.JUDGED)


def test_a_slowed_board_differs_in_its_rate_only():
    board = find_board("gelslim")
    slow = held.slowed(board)
    assert slow.camera.rate_mhz == 1000 * held.RATE_HZ
    camera = board.camera.model_copy(update={"rate_mhz": slow.camera.rate_mhz})
    assert slow.model_dump() == board.model_copy(update={"camera": camera}).model_dump()


def test_a_board_without_a_twin_is_refused(tmp_path):
    with pytest.raises(InputError, match="no optics to simulate"):
        held.run(board_without_twin(tmp_path))


def test_the_table_has_a_row_for_each_touch_before_and_after():
    row = {"seconds": 10.0, "start": -4.7, "end": 10.1, "rms": 7.4}
    text = held.table({
        "board": "gelslim", "true_loss": 0.25, "fit": {"terms": [{"part": 0.085, "time_s": 1.0}]},
        "rows": {"elastic": [row], "relaxation": [{**row, "rms": 0.8}]},
    })  # fmt: skip
    assert all(part in text for part in ("25 %", "8.5 % in 1 s", "-4.7 %", "+10.1 %", "7.4 %", "0.8 %"))
