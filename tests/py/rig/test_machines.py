"""G-code machines on a pty: Marlin and GRBL, their errors, resets and alarms."""

from __future__ import annotations

import os
import threading
import time

import pytest
from hang import until

from ruffini import host_clock
from ruffini.errors import NoDeviceError, RefusedError
from ruffini.rig import gcode_line
from ruffini.rig.emulated_dialects import EmulatedGrbl, EmulatedMarlin
from ruffini.rig.emulated_machine import EmulatedMachine
from ruffini.rig.grbl import Grbl
from ruffini.rig.marlin import Marlin
from ruffini.rig.stage import Place, Rotary, no_guard

A, B = Place(0.01, 0.02, 0.04), Place(0.011, 0.02, 0.0395)
FAR = Place(6.0, 0.02, 0.04)  # two minutes away at 0.05 m/s: it is never reached
KINDS = {"marlin": (EmulatedMarlin, Marlin), "grbl": (EmulatedGrbl, Grbl)}


@pytest.fixture(params=KINDS)
def pair(request):
    """A machine, homed, and what drives it."""
    emulated, driver = KINDS[request.param]
    with emulated(bottom_z_m=0.01) as machine:
        stage = driver(machine.port)
        stage.home()
        yield machine, stage
        stage.close()


def stopped() -> None:
    raise RefusedError("the stop key")


def once_it_moves(machine: EmulatedMachine, act) -> None:
    """Act in a thread of its own, as soon as the machine moves."""

    def wait() -> None:
        until(machine.is_moving, "the move")
        act()

    threading.Thread(target=wait, daemon=True).start()


def test_it_stands_where_it_was_sent_when_the_move_returns(pair):
    machine, stage = pair
    stage.move(A, 0.5)
    assert machine.place().distance(A) < 1e-6
    start = time.monotonic()
    stage.move(B, 0.01)
    assert time.monotonic() - start >= A.distance(B) / 0.01  # it does not return before it stands
    assert machine.place().distance(B) < 1e-6
    assert stage.position().distance(B) < 1e-6


def test_not_homed_is_refused():
    for emulated, driver in KINDS.values():
        with emulated() as machine:
            stage = driver(machine.port)
            with pytest.raises(RefusedError, match="not homed"):
                stage.move(A, 0.1)
            stage.close()
            assert not any("G1" in line for line in machine.received)


def test_guard_halts_within_the_move_and_the_next_move_works(pair):
    machine, stage = pair
    stage.move(A, 0.5)

    def guard() -> None:
        if machine.place().x_m > 0.013:
            raise RefusedError("too much force")

    with pytest.raises(RefusedError, match="too much force"):
        stage.move(FAR, 0.05, guard)
    stopped = machine.place()
    assert 0.013 < stopped.x_m < FAR.x_m
    time.sleep(0.05)  # in which it would go on
    assert machine.place() == stopped
    stage.move(A, 0.5)
    assert machine.place().distance(A) < 1e-6


def test_reset_on_the_way_is_told_and_nothing_moves_until_it_is_homed(pair):
    machine, stage = pair
    stage.move(A, 0.5)
    once_it_moves(machine, machine.power_glitch)
    with pytest.raises(NoDeviceError, match="was reset: it does not know where it is"):
        stage.move(FAR, 0.05)
    with pytest.raises(RefusedError, match="not homed"):
        stage.move(A, 0.5)
    stage.home() if isinstance(stage, Grbl) else None


def test_limit_switch_stops_it(pair):
    machine, stage = pair
    stage.move(A, 0.5)
    with pytest.raises(RefusedError, match=r"alarm 1 \(a limit switch|ran into a switch"):
        stage.move(Place(0.01, 0.02, 0.0), 0.5)
    assert machine.place().z_m == pytest.approx(0.01)
    with pytest.raises(RefusedError, match="not homed"):
        stage.move(A, 0.5)


def test_unplugged_is_told(pair):
    machine, stage = pair
    once_it_moves(machine, machine.unplug)
    with pytest.raises(NoDeviceError, match=r"unplugged|does not answer"):
        stage.move(FAR, 0.05)


def test_one_that_does_not_answer_a_halt_is_told_whatever_the_patience(monkeypatch):
    monkeypatch.setattr("ruffini.rig.grbl.HALT_ANSWER_S", 0.2)
    with EmulatedGrbl() as machine:
        stage = Grbl(machine.port)
        stage.home()
        machine.is_deaf = True
        with pytest.raises(NoDeviceError, match=r"does not report its state for 0\.2 s"):
            stage.halt()
        stage.close()


def test_after_a_limit_switch_it_can_still_be_raised(pair):
    machine, stage = pair
    stage.move(A, 0.5)
    with pytest.raises(RefusedError):
        stage.move(Place(0.01, 0.02, 0.0), 0.5)
    stage.raise_by(0.005, 0.1)
    assert machine.place().z_m == pytest.approx(0.015)
    with pytest.raises(RefusedError, match="not homed"):
        stage.move(A, 0.5)
    stage.home()
    stage.move(A, 0.5)
    assert machine.place().distance(A) < 1e-6


def test_marlin_sends_again_what_was_garbled():
    with EmulatedMarlin() as machine:
        stage = Marlin(machine.port)
        stage.home()
        machine.garble = 2
        stage.move(A, 0.5)
        assert machine.place().distance(A) < 1e-6
        machine.garble = 50
        with pytest.raises(NoDeviceError, match=r"does not understand .* after 6 tries"):
            stage.move(B, 0.5)
        stage.close()


class SlowTime(host_clock.RealTime):
    """Simulated time of a computer that has little time for it: a tenth of the real one from now on."""

    def __init__(self) -> None:
        self._start_s = time.monotonic()

    def now(self) -> float:
        return self._start_s + 0.1 * (time.monotonic() - self._start_s)

    def sleep(self, duration_s: float) -> None:
        time.sleep(10 * duration_s)


@pytest.mark.realtime
@pytest.mark.parametrize("busy_s", [0.1, 99.0])
def test_a_marlin_that_says_that_it_is_busy_is_waited_for(monkeypatch, busy_s):
    """In real time, as the driver's patience is: simulated time may go on so slowly that no note of it came.

    The machine says it five times as often as the driver wants to hear it.
    """
    with EmulatedMarlin() as machine:
        stage = Marlin(machine.port)
        stage.home()
        stage.move(A, 0.5)
        monkeypatch.setattr("ruffini.rig.marlin.ANSWER_S", 0.5)
        monkeypatch.setattr("ruffini.rig.emulated_dialects.BUSY_S", busy_s)
        there = Place(A.x_m + 0.003, A.y_m, A.z_m)
        start = time.monotonic()
        with host_clock.lent(SlowTime()):
            if busy_s > 1:
                with pytest.raises(NoDeviceError, match="does not answer 'M400'"):
                    stage.move(there, 0.03)
            else:
                stage.move(there, 0.03)  # 0.1 s, a second of the real clock
                assert time.monotonic() - start > 2 * 0.5
        stage.close()


def test_marlin_without_emergency_parser_halts_at_the_end_of_the_move():
    with EmulatedMarlin(has_emergency_parser=False) as machine:
        stage = Marlin(machine.port)
        stage.home()
        stage.move(A, 0.5)

        def guard() -> None:
            if sum("M400" in line for line in machine.received) == 2:  # the second move waits for its end
                raise RefusedError("too much force")

        with pytest.raises(RefusedError, match="too much force"):
            stage.move(B, 0.01, guard)
        assert machine.place().distance(B) < 1e-6
        stage.move(A, 0.5)
        stage.close()


def test_grbl_alarm_lock_is_named():
    with EmulatedGrbl() as machine:
        stage = Grbl(machine.port)
        stage.home()
        machine._alarm(9)
        with pytest.raises(RefusedError, match=r"alarm 9 \(no limit switch was found|error 9"):
            stage.move(A, 0.5)
        stage.home()
        stage.move(A, 0.5)
        stage.close()


def test_nothing_there(tmp_path):
    for driver in (Marlin, Grbl):
        with pytest.raises(NoDeviceError, match="cannot be opened"):
            driver(str(tmp_path / "none"))


def test_the_wrong_dialect_is_told(monkeypatch):
    monkeypatch.setattr("ruffini.rig.grbl.START_S", 0.3)
    monkeypatch.setattr("ruffini.rig.marlin.START_S", 0.3)
    machine: EmulatedMachine
    with EmulatedMarlin() as machine, pytest.raises(NoDeviceError, match="does it run GRBL"):
        Grbl(machine.port)
    with EmulatedGrbl() as machine, pytest.raises(NoDeviceError, match="does it run Marlin"):
        Marlin(machine.port)


TUBE = Rotary("A", radius_m=0.04, x_m=0.11)
ROUND = Place(0.02, 0.03, 0.045)  # 20 mm round the tube


@pytest.mark.parametrize("kind", KINDS)
def test_the_tip_goes_up_then_an_axis_turns_the_tube_and_x_stays(kind: str) -> None:
    emulated, driver = KINDS[kind]
    with emulated(rotary=TUBE) as machine:
        stage = driver(machine.port, rotary=TUBE)
        stage.home()
        stage.move(ROUND, 0.5)
        assert machine.place().distance(ROUND) < 1e-6
        assert stage.position().distance(ROUND) < 2e-6
        stage.close()
    up, turn, straight = [line for line in machine.received if "G1" in line]
    assert "A28.6479 F42971.8" in turn  # 20 mm / 40 mm in degrees; 0.5 m/s in degrees a minute
    assert not set("XYZ") & set(turn.partition("G1")[2])
    assert "G1 Z45.0000 F30000.0" in up
    assert "G1 X110.0000 Y30.0000 F30000.0" in straight


@pytest.mark.parametrize("kind", KINDS)
def test_a_machine_without_the_axis_says_so(kind: str) -> None:
    emulated, driver = KINDS[kind]
    with emulated() as machine:
        stage = driver(machine.port, rotary=TUBE)
        stage.home()
        with pytest.raises(NoDeviceError, match=r"check \[stage\] rotary_axis"):
            stage.position()
        stage.close()


@pytest.mark.parametrize(("emulated", "driver"), [(EmulatedMarlin, Marlin), (EmulatedGrbl, Grbl)])
def test_a_five_axis_stage_turns_what_is_pressed_or_says_that_it_has_no_such_axis(emulated, driver, monkeypatch):
    with emulated(turns="AB") as machine:
        stage = driver(machine.port)
        stage.home()
        stage.turn({"A": -30.0, "B": 20.0})
        assert machine.turned == {"A": -30.0, "B": 20.0}
        stage.move(stage.position().plus(Place(1e-3, 0.0, 0.0)), 0.03)
        assert machine.turned == {"A": -30.0, "B": 20.0}
        with pytest.raises(RefusedError, match="the stop key"):
            stage.turn({"A": 0.0}, stopped)
        # The guard also watches while the turn is waited for: not only the command that starts it.
        command = stage._command
        monkeypatch.setattr(
            stage, "_command", lambda text, s, guard=no_guard: command(text, s, no_guard if "G1" in text else guard)
        )
        with pytest.raises(RefusedError, match="the stop key"):
            stage.turn({"A": 0.0}, stopped)
        monkeypatch.undo()
        with pytest.raises(NoDeviceError, match=r"has not turned its axis C.*check \[holder\] axes"):
            stage.turn({"C": 10.0})
        stage.close()


def test_a_machine_that_takes_no_bytes_is_told_in_one_sentence(monkeypatch):
    monkeypatch.setattr(gcode_line, "SEND_S", 0.05)
    reads_nothing, port = os.openpty()
    line = gcode_line.GcodeLine(os.ttyname(port), gcode_line.BAUD)
    with pytest.raises(NoDeviceError, match=r"takes no bytes, or was unplugged.*check its power and cable"):
        line.send(b"?" * (1 << 20))
    line.close()
    os.close(reads_nothing)
    os.close(port)
