"""A camera at this computer for a program: what is a recording, and why its firmware ended."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

import ruffini
from ruffini.errors import LineLostError, NoDeviceError
from ruffini.live import unit

MEMORY = Path("/dev/shm")


@pytest.mark.skipif(not os.access(MEMORY, os.W_OK), reason="needs a folder below /dev that can be written")
def test_pictures_below_dev_are_no_camera() -> None:
    with tempfile.TemporaryDirectory(dir=MEMORY) as folder:
        cv2.imwrite(f"{folder}/0.png", np.zeros((240, 320, 3), np.uint8))
        source, board = unit.choose(folder, "gelslim")
    assert (source.camera, board.name) == (Path(folder), "gelslim")


def test_a_device_is_no_recording(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(unit, "local_cameras", list)
    for device in ("/dev/null", Path("/dev/null")):
        with pytest.raises(NoDeviceError, match="no camera '/dev/null'"):
            unit.choose(device, "gelslim")


@pytest.mark.parametrize(("said", "reason"), [("the camera was unplugged", "the camera was unplugged"), ("", "lost")])
def test_a_lost_line_says_what_ended_the_firmware(said: str, reason: str, monkeypatch: pytest.MonkeyPatch) -> None:
    @contextlib.contextmanager
    def ended(*_: object) -> Iterator[SimpleNamespace]:
        yield SimpleNamespace(port="/dev/pts/9", has_ended=lambda: True, problem=lambda: said)

    monkeypatch.setattr(unit, "choose", lambda *_: (None, None))
    monkeypatch.setattr(unit, "running_unit", ended)
    with pytest.raises(NoDeviceError, match=reason), ruffini.local_camera("DIGIT") as port:
        raise LineLostError(f"{port}: the line was lost")
