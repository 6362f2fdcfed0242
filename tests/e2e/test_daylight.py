"""Daylight on the twin: flagged without light.alternation, newtons with it; what a lost frame of a pair does."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from hang import HANG_S
from tiny_sensor import write_board
from tiny_twin import Twin

from ruffini.boards import Board, find_board
from ruffini.daemon import running_daemon
from ruffini.device import Connection
from ruffini.sim.scenario import Scenario
from ruffini.sim.serve import Scripted, TwinServer
from ruffini.sim.unit import TwinUnit

ALTERNATES = """
[light]
chip = "gpiochip0"
line = "LAMPS"
alternation = "lit_dark"

[exposure]
time_us = 5000
gain_1e3 = 1000
red_1e3 = 1000
blue_1e3 = 1000
"""
N_HELD = 25


@pytest.fixture(scope="module")
def alternating(twin: Twin, tmp_path_factory: pytest.TempPathFactory) -> Twin:
    """The twin whose lamps are lit in every second frame."""
    changes = {"threshold_un = 3000": "threshold_un = 12000", "rate_mhz = 60000": "rate_mhz = 20000"}
    folder = write_board(tmp_path_factory.mktemp("alternating") / "tiny", changes)
    with (folder / "board.toml").open("a") as file:
        file.write(ALTERNATES)
    assert twin.board.folder is not None
    shutil.copy(twin.board.folder / "twin.toml", folder)
    unit = TwinUnit(find_board(folder), twin.unit.twin, twin.unit.model, twin.unit.compliance)
    return Twin(unit, twin.calibration)


def story(board: Board, *faults: dict[str, object]) -> Scenario:
    """A press, the faults from when rest is learned on."""
    n_rest = board.pipeline.n_rest_frames
    return Scenario.model_validate({
        "schema": 1, "program": "press", "touch": {"depth_um": 700, "radius_um": 4000, "frames": 6},
        "fault": [{"first_frame": n_rest + 1, "n_frames": 1000, **fault} for fault in faults],
    })  # fmt: skip


def run(twin: Twin, folder: Path, scenario: Scenario) -> tuple[dict[int, tuple[float, set[str]]], object, int]:
    """Force along z in newtons and flags by frame, the last STATUS, and how many frames there were to see."""
    frames = Scripted(twin.unit, scenario)
    said = {}
    is_whole = [scenario.is_sent(i) and (not twin.board.alternates or scenario.is_sent(i, is_unlit=True))
                for i in range(len(frames))]  # fmt: skip
    last = max(i for i, sent in enumerate(is_whole) if sent)
    assert twin.board.folder is not None
    with (
        TwinServer(twin.unit.renderer(), frames, scenario, folder / "twin"),
        running_daemon(twin.board.folder, f"twin:{folder / 'twin'}", folder / "store", "--lockstep",
                       "--wait-for-host", "--linger") as port,
        Connection(port) as sensor,
    ):  # fmt: skip
        sensor.flash(twin.calibration)
        sensor.subscribe(wrench=1)
        for frame, message in sensor.stream(timeout_s=HANG_S):
            if sensor.schema.type_name(frame.type) != "WRENCH":
                continue
            flags = set(sensor.schema.enum_names("FlagBit", message.stamp.flags))
            said[message.stamp.frame] = message.force_z_un * 1e-6, flags
            n = message.stamp.frame
            period = 10**9 // twin.board.camera.rate_mhz
            half = period // 2 if twin.board.alternates else 0  # the lit one's time
            assert message.stamp.capture_us == n * period + half
            if n == last:
                break
        sensor._send("STATUS")
        status = next(m for f, m in sensor.stream(timeout_s=HANG_S) if sensor.schema.type_name(f.type) == "STATUS")
    return said, status, len(frames)


DAYLIGHT = {"kind": "light_leak", "level_1e3": 300}


def test_daylight_that_was_flagged_gives_newtons(twin: Twin, alternating: Twin, tmp_path: Path) -> None:
    (tmp_path / "a").mkdir(), (tmp_path / "b").mkdir(), (tmp_path / "c").mkdir()
    by_night, _, n = run(alternating, tmp_path / "a", story(alternating.board))
    by_day, _, _ = run(alternating, tmp_path / "b", story(alternating.board, DAYLIGHT))
    plain, _, _ = run(twin, tmp_path / "c", story(twin.board, DAYLIGHT))
    n_rest = twin.board.pipeline.n_rest_frames
    assert set(by_day) == set(by_night) == set(plain) == set(range(n))

    lit = range(n_rest + 1, n)  # while the daylight is there
    assert all("FLAG_LIGHT" in plain[i][1] for i in lit), "flagged without alternation"
    new_store = {"FLAG_REST_UNVERIFIED"}
    assert all(by_day[i][1] <= new_store for i in lit), {i: by_day[i][1] for i in lit if by_day[i][1] - new_store}
    night, day = (np.array([run_[i][0] for i in lit]) for run_ in (by_night, by_day))
    assert night.min() < -0.3  # newtons
    error = np.abs(day - night)
    print(
        f"\nSIMULATED daylight of 0.3: press of {-night.min():.3f} N, by day {-day.min():.3f} N, "
        f"largest difference {error.max():.3f} N; without alternation {-min(plain[i][0] for i in lit):.3f} N, flagged"
    )
    assert error.max() < 0.05 * -night.min()


def test_frames_whose_partner_was_lost_are_not_used_and_counted(alternating: Twin, tmp_path: Path) -> None:
    """A third of the camera's frames is lost: pairs of which both came are as they were, the others are missing."""
    (tmp_path / "a").mkdir(), (tmp_path / "b").mkdir()
    whole, _, n = run(alternating, tmp_path / "a", story(alternating.board))
    scenario = story(alternating.board, {"kind": "drop", "share_1e3": 330})
    lossy, status, _ = run(alternating, tmp_path / "b", scenario)
    came = [(scenario.is_sent(i, is_unlit=True), scenario.is_sent(i)) for i in range(n)]
    assert set(lossy) == {i for i, both in enumerate(came) if all(both)}
    assert 0.2 * n < len(lossy) < 0.9 * n
    assert all(lossy[i] == whole[i] for i in lossy)
    alone = sum(dark != lit for dark, lit in came)
    # A dark one that is followed by a lit one of another pair is one invalid frame, not two.
    assert 0 < status.drops.invalid_frame <= alone


def test_a_recording_of_it_holds_what_the_device_computes_from(alternating: Twin, tmp_path: Path) -> None:
    """The device's own picture, asked for over the line, is the twin's lit one less its dark one, bit for bit."""
    scenario = story(alternating.board, DAYLIGHT)
    frames = Scripted(alternating.unit, scenario)
    assert alternating.board.folder is not None
    server = TwinServer(alternating.unit.renderer(), frames, scenario, tmp_path / "twin")
    with (
        server,
        running_daemon(alternating.board.folder, f"twin:{tmp_path / 'twin'}", tmp_path / "store", "--lockstep",
                       "--wait-for-host") as port,
        Connection(port) as sensor,
    ):  # fmt: skip
        sensor.subscribe(image=1)
        n_rest = alternating.board.pipeline.n_rest_frames
        image = next(
            message
            for frame, message in sensor.stream(timeout_s=HANG_S)
            if sensor.schema.type_name(frame.type) == "IMAGE" and message.stamp.frame > n_rest + 1
        )
    wanted = server.picture(image.stamp.frame)
    assert wanted is not None
    sent = np.frombuffer(image.data, np.uint8).reshape(image.height_px, image.width_px, -1)
    assert sent.shape[2] == 3
    assert np.array_equal(sent, wanted[:: image.step_px, :: image.step_px])
