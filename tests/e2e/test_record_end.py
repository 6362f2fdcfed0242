"""`record` says why it ended: without a number of frames, and with one that was not reached."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest
from command_line import refusal_in, run_ruffini
from told_sensor import ToldSensor, info_of, told_field

from ruffini.boards import find_board
from ruffini.record import Recording


@pytest.mark.parametrize("number", [[], ["--n", "1000"]])
def test_a_sensor_that_falls_silent_ends_it_with_3(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: list[str]
) -> None:
    monkeypatch.setattr("ruffini.record.mcap_file.SILENCE_S", 1.0)
    board, path = find_board("gelslim"), tmp_path / "a.mcap"
    with ToldSensor([info_of(board)], told_field(board.grid.n_x, board.grid.n_y), rate_hz=None) as device:
        sender = threading.Thread(target=device.send, args=(12,))  # at once: no pause that a busy computer makes longer
        sender.start()
        done = run_ruffini("record", path, "--resume", "0", *number, port=device.port)
        sender.join()
    assert done.code == 3
    sentence = refusal_in(done.err)
    assert "nothing came for 1 s: is ruffinid running?" in sentence
    assert f"(after 12 frames; {path} holds them)" in sentence
    assert sum(1 for _ in Recording(path).frames(partial=True)) == 12
