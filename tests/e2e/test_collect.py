"""A whole bench without hardware: real daemon on a pty, G-code machine on a pty, force/torque over UDP, the twin."""

from __future__ import annotations

import contextlib
import shutil
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hang import until
from kept import kept
from scipy.spatial.transform import Rotation
from tiny_sensor import ROOT
from tiny_twin import Twin

from ruffini.boards import Board, find_board
from ruffini.demo.twin_session import LOGGER_DRIFT, Simulated, TwinOptions, open_logged, open_simulated
from ruffini.errors import InputError, NoDeviceError, RefusedError
from ruffini.estimators.wrench.log import read_feature_runs
from ruffini.rig.bench import Bench
from ruffini.rig.by_log import join, record
from ruffini.rig.collect import Progress, collect
from ruffini.rig.emulated_references import ASKEW, NO_MOUNT, Mount
from ruffini.rig.found import is_held, on_reference_clock, reference_in_pad
from ruffini.rig.guarded_stage import Limits
from ruffini.rig.log_file import LogWriter, read_log
from ruffini.rig.program import ByHand, Span, Touch, plan
from ruffini.rig.session import SensorParts, ready_bench, watched_stream
from ruffini.rig.stage import Place
from ruffini.rig.twin_bench import ORIGIN
from ruffini.rig.units import POUND_N
from ruffini.sim.bodies.platform import Platform
from ruffini.sim.bodies.platform_unit import PlatformUnit
from ruffini.sim.pad import PadModel, surface_compliance
from ruffini.sim.settings import load_twin

SLOW_LINE = 1e5  # bytes a second of simulated time, for pictures: each sixth frame's
FACTS = {"board": "tiny", "program": "grid", "seed": 1}
LIMITS = Limits(0.006, 0.005, 0.002, -0.0015, 0.001, 5.0, near_m=0.0003)
PLAN = plan("grid", Span(0.0045, 0.0035, 0.0009, 0.0008), 7, seed=1)
STRAIGHT = plan("balls", Span(0.003, 0.002, 0.0004, 0.0), 4, seed=1)


@contextlib.contextmanager
def bench(
    twin: Twin,
    program: str = "grid",
    machine: str = "marlin",
    mount: Mount = ASKEW,
    stall_s: float = 15.0,
) -> Iterator[tuple[Bench, Simulated]]:
    """A bench on the tiny twin, calibrated, homed and at rest."""
    with contextlib.ExitStack() as stack:
        simulated = open_simulated(
            stack, twin.board, program, TwinOptions(machine, mount=mount, is_hurried=True), twin.unit
        )
        simulated.parts.sensor.flash(twin.calibration)
        parts = replace(
            simulated.parts, pace=simulated.parts.pace._replace(stall_s=stall_s, image_bytes_per_s=SLOW_LINE)
        )
        yield stack.enter_context(ready_bench(parts, twin.board, LIMITS)), simulated


class Disturbed:
    """Collects four straight presses; disturbs them after the next one that is good."""

    def __init__(self, out: Path) -> None:
        self.out = out

    def log(self) -> LogWriter:
        return LogWriter(self.out, FACTS)

    def run(self, b: Bench, disturb: Callable[[], object] = lambda: None) -> int:
        """How many had been there before."""
        n_before = len(self.log().done())

        def tell(p: Progress) -> None:
            if p.n_done == n_before + 1:
                disturb()

        collect(b, STRAIGHT, self.log(), tell=tell)
        return n_before


def is_believed(b: Bench) -> bool:
    with contextlib.suppress(RefusedError):
        b.reference.latest()
        return True
    return False


def is_up(simulated: Simulated) -> bool:
    assert simulated.machine is not None
    return simulated.machine.place().z_m >= ORIGIN.z_m + LIMITS.top_m - 1e-6


def test_touches_are_collected_kept_and_gone_on_with(bench_twin: Twin, tmp_path: Path) -> None:
    told: list[Progress] = []
    out = tmp_path / "log.h5"
    with bench(bench_twin) as (b, _):
        beside = [*PLAN[:2], Touch(0.05, 0, 0.0005)]
        with pytest.raises(RefusedError, match="beside the pad"):
            collect(b, beside, LogWriter(out, FACTS))
        assert LogWriter(out, FACTS).done() == {0, 1}
        with pytest.raises(InputError, match="begun with another seed"):
            LogWriter(out, {**FACTS, "seed": 2})
        collect(b, PLAN, LogWriter(out, FACTS), tell=told.append)
    assert [p.n_done for p in told] == list(range(3, len(PLAN) + 1))
    assert told[-1].remaining_s == 0
    log = read_log(out)
    assert log.facts == FACTS
    with pytest.raises(InputError, match="exists and is complete"):
        LogWriter(out, FACTS)
    checks = {name: check["ok"] for name, check in log.found["checks"].items()}
    assert checks == {"rate": True, "tare": True, "axes": True, "unit": True}
    assert "why_not" not in log.found["frame"], log.found
    # What the bench was made with: a reference that stands askew, on one clock with the sensor.
    turn = Rotation.from_matrix(np.array(log.found["frame"]["rotation"]))
    true = Rotation.from_euler("xyz", ASKEW.turn_deg, degrees=True)
    assert np.rad2deg((turn * true.inv()).magnitude()) < 4
    assert log.found["frame"]["arm_m"] == pytest.approx(ASKEW.arm_m, abs=2e-3)
    for touch, wanted in zip(log.touches, PLAN, strict=True):
        a, f = touch.arrays, touch.facts
        assert (f["kind"], f["x_m"], f["depth_m"]) == ("press", wanted.x_m, wanted.depth_m)
        truth = reference_in_pad(log, touch)[is_held(a["reference_s"], f)].mean(axis=0)
        seen = a["stream_wrench"][is_held(a["stream_host_s"], f)].mean(axis=0)
        assert truth[2] < -0.09
        assert seen[2] == pytest.approx(truth[2], rel=0.25)
        if wanted.shear_x_m or wanted.shear_y_m:  # the tip pulls the pad along
            assert np.dot(truth[:2], [wanted.shear_x_m, wanted.shear_y_m]) > 0
        assert a["field_displacement"].shape[-1] == 3
        assert abs(a["rest_field_displacement"]).max() < 0.2 * abs(a["field_displacement"]).max()
        assert a["marker_displacement"].shape[1:] == (63, 2)
        assert len(a["image"]) >= 2
        assert a["stage_place"][-1] == pytest.approx(
            [wanted.x_m + wanted.shear_x_m, wanted.y_m + wanted.shear_y_m, f["contact_z_m"] - wanted.depth_m]
        )
        assert abs(on_reference_clock(log, touch) - a["stream_host_s"]).max() < 0.5
    assert abs(log.found["clocks"][0]["late_s"]) < 0.2  # the camera's pipeline is slower than the reference's


def test_a_reference_in_pounds_or_askew_is_told_before_the_first_touch(bench_twin: Twin, tmp_path: Path) -> None:
    pressed = Disturbed(tmp_path / "log.h5")
    with bench(bench_twin, mount=Mount((90.0, 0.0, 0.0))) as (b, simulated):
        with pytest.raises(InputError, match=r"on \+y instead of -z: axes are swapped"):
            pressed.run(b)
        assert is_up(simulated)
        simulated.twin.cell.mount = Mount((180.0, 0.0, 0.0))
        with pytest.raises(InputError, match=r"sees a press as \+z"):
            pressed.run(b)
        simulated.twin.cell.mount = NO_MOUNT
        simulated.twin.cell.gain = np.full(6, 1 / POUND_N)
        with pytest.raises(InputError, match="seems to count in lb, not in N"):
            pressed.run(b)
        assert is_up(simulated)
        assert pressed.log().done() == set()


def test_reference_that_fails_in_the_middle_lifts_the_tip_and_loses_nothing(bench_twin: Twin, tmp_path: Path) -> None:
    """One bench, disturbed in one way after the other; each time the same command goes on."""
    pressed = Disturbed(tmp_path / "log.h5")
    with bench(bench_twin) as (b, simulated):
        cell, machine = simulated.twin.cell, simulated.machine
        assert machine is not None
        with pytest.raises(RefusedError, match="is saturated"):
            pressed.run(b, lambda: setattr(cell, "is_saturated", True))
        assert is_up(simulated)
        cell.is_saturated = False
        until(lambda: is_believed(b), "a reading that is not saturated")

        with pytest.raises(RefusedError, match="lost steps") as told:
            pressed.run(b, lambda: setattr(machine, "slip", Place(0.0, 0.0, 0.0008)))
        assert "they are set aside" in told.value.__notes__[0]
        assert is_up(simulated)
        machine.slip = Place(0.0, 0.0, 0.0)
        assert pressed.log().done() == {0}  # three were pressed on a pad that was not where it was

        with pytest.raises(RefusedError, match=r"drifted by 7\.5 % of its range"):
            pressed.run(b, lambda: setattr(cell, "drift", np.array([0, 0, 1.5, 0, 0, 0])))
        assert is_up(simulated)
        assert len(pressed.log().done()) == 2

        with pytest.raises(NoDeviceError, match=r"fell silent|sends nothing"):
            pressed.run(b, lambda: setattr(cell, "is_plugged", False))
        assert is_up(simulated)
        assert len(pressed.log().done()) == 3
    with bench(bench_twin) as (b, _):  # plugged in again
        assert pressed.run(b) == 3
    assert len(read_log(tmp_path / "log.h5").touches) == 4


def test_machine_or_camera_that_fails_in_the_middle(
    bench_twin: Twin,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pressed, goes_on = Disturbed(tmp_path / "log.h5"), threading.Event()
    with bench(bench_twin, machine="grbl", stall_s=3.0) as (b, simulated):
        machine = simulated.machine
        assert machine is not None
        with pytest.raises(RefusedError, match="alarm 1"):
            pressed.run(b, lambda: setattr(machine, "bottom_z_m", ORIGIN.z_m + 0.0001))
        assert is_up(simulated)  # by a way that needs no homing
        with pytest.raises(RefusedError, match="not homed"):
            pressed.run(b)
        machine.bottom_z_m = -0.1
        assert b.stage is not None
        b.stage.stage.home()
        with pytest.raises(RefusedError, match="stopped by a key"):
            pressed.run(b, lambda: setattr(b, "guard", _stop))
        b.guard = lambda: None

        def stall() -> None:
            """The camera stands still; the reference goes on, slowly."""
            monkeypatch.setattr(simulated.twin.twin, "states", stand_still)
            threading.Thread(target=speak, daemon=True).start()

        def stand_still(_: int) -> None:
            assert simulated.clock is not None
            simulated.clock.without_frames()
            goes_on.wait()

        def speak() -> None:
            while not goes_on.wait(0.5):
                simulated.twin.cell.measure(0, np.zeros(6))

        try:
            with pytest.raises(NoDeviceError, match="no frame for 3 s"):
                pressed.run(b, stall)
        finally:
            goes_on.set()
        assert is_up(simulated)
        assert len(pressed.log().done()) == 3


def _stop() -> None:
    raise RefusedError("stopped by a key")


def test_the_sensors_force_stops_the_machine_too(bench_twin: Twin, tmp_path: Path) -> None:
    """The reference sees a tenth of the force; the sensor knows better."""
    with contextlib.ExitStack() as stack:
        simulated = open_simulated(
            stack, bench_twin.board, "grid", TwinOptions(mount=NO_MOUNT, is_hurried=True), bench_twin.unit
        )
        simulated.twin.cell.gain = np.full(6, 0.1)
        simulated.parts.sensor.flash(bench_twin.calibration)
        parts = replace(simulated.parts, max_force_n=0.5)
        b = stack.enter_context(ready_bench(parts, bench_twin.board, LIMITS))
        b.reference.tare(0.3)
        assert b.stage is not None
        with pytest.raises(RefusedError, match="the sensor measures"), b.safely():
            b.stage.approach(0.0, 0.0)
        assert is_up(simulated)


def test_weights_and_presses_by_hand(bench_twin: Twin, tmp_path: Path) -> None:
    span = Span(0.003, 0.002, 0.0006, 0.0)
    with bench(bench_twin, "weights") as (b, _):
        collect(b, plan("weights", span, 2, 1, ByHand(grams=(40.0, 90.0))), LogWriter(tmp_path / "w.h5", {}))
    log = read_log(tmp_path / "w.h5")
    assert [t.facts["grams"] for t in log.touches] == [40, 90]
    for touch in log.touches:
        a, f = touch.arrays, touch.facts
        weight_n = 9.80665e-3 * f["grams"]
        assert a["reference_wrench"][is_held(a["reference_s"], f), 2] == pytest.approx(-weight_n)
        assert a["stream_wrench"][is_held(a["stream_host_s"], f), 2].mean() == pytest.approx(-weight_n, rel=0.3)
    with bench(bench_twin, "free", mount=NO_MOUNT) as (b, _):
        items = plan("free", span, 2, 1, ByHand(force_n=0.8))
        collect(b, items, LogWriter(tmp_path / "f.h5", {}))
        b.max_force_n = 0.3
        with pytest.raises(RefusedError, match=r"more than the 0\.3 N allowed"):
            collect(b, items, LogWriter(tmp_path / "too_hard.h5", {}))
    for touch, item in zip(read_log(tmp_path / "f.h5").touches, items, strict=True):
        a, f = touch.arrays, touch.facts
        held_n = -a["reference_wrench"][is_held(a["reference_s"], f), 2].mean()
        assert held_n == pytest.approx(item.force_n, rel=0.25)


def test_another_programs_csv_with_a_drifting_clock(bench_twin: Twin, tmp_path: Path) -> None:
    log = LogWriter(tmp_path / "log.h5", {})
    with contextlib.ExitStack() as stack:
        parts, csv = open_logged(
            stack, bench_twin.board, TwinOptions(is_hurried=True), tmp_path / "force.csv", bench_twin.unit
        )
        assert isinstance(parts, SensorParts)
        parts.sensor.flash(bench_twin.calibration)
        watched = stack.enter_context(
            watched_stream(parts.sensor, bench_twin.board, parts.pace._replace(image_bytes_per_s=SLOW_LINE))
        )
        record(watched.stream, parts.person, log, watched.session)
    (tmp_path / "no_time.csv").write_text(csv.read_text().replace("time_s", "when", 1))
    with pytest.raises(InputError, match="no column of time"):
        join(log, tmp_path / "no_time.csv", watched.bad_flags, longest_gap_s=8.0)
    joined = join(log, csv, watched.bad_flags, longest_gap_s=8.0)
    assert joined.n_touches >= 6
    whole = read_log(tmp_path / "log.h5")
    assert abs(whole.found["csv_clock"]["drift"] - LOGGER_DRIFT) < 5e-3
    for touch in whole.touches:
        a, f = touch.arrays, touch.facts
        truth = a["reference_wrench"][is_held(a["reference_s"], f), 2].mean()
        assert a["stream_wrench"][is_held(a["stream_host_s"], f), 2].mean() == pytest.approx(truth, rel=0.3)


COARSE_FTOUCH = {
    "width_px = 640": "width_px = 320", "height_px = 480": "height_px = 240", "rate_mhz = 30000": "rate_mhz = 20000",
    "focal_mpx = 460000": "focal_mpx = 230000", "center_x_mpx = 319500": "center_x_mpx = 159500",
    "center_y_mpx = 239500": "center_y_mpx = 119500", "step_px = 4": "step_px = 2",
}  # fmt: skip


def coarse_ftouch(folder: Path) -> Board:
    """F-TOUCH with a camera of a quarter of its pixels, as many as the targets need."""
    folder = Path(shutil.copytree(ROOT / "boards" / "ftouch", folder / "ftouch"))
    text = (folder / "board.toml").read_text()
    for old, new in COARSE_FTOUCH.items():
        assert old in text, old
        text = text.replace(old, new, 1)
    (folder / "board.toml").write_text(text)
    return find_board(folder)


def test_the_conditions_of_a_rigid_connector_reach_the_log_with_its_targets(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ruffini.rig.emulated_person.LOAD_FRAMES", 36)
    board = coarse_ftouch(tmp_path)
    settings, pad = load_twin(board), board.pad
    assert settings.platform is not None
    model = PadModel(
        pad.size_x_um * 1e-6, pad.size_y_um * 1e-6, pad.thickness_um * 1e-6, pad.modulus_pa,
        pad.poisson_1e4 * 1e-4, n_cells_x=10, n_cells_y=9, layers=(0.2, 0.3, 0.5),
    )  # fmt: skip
    unit = PlatformUnit(
        board, settings, model, kept(surface_compliance, model), platform=Platform.of(settings.platform)
    )
    loads = plan("conditions", Span(0.003, 0.002, 0.0006, 0.0), 18, 1, ByHand(force_n=0.8, torque_nm=0.008))
    items = [loads[i] for i in (0, 6, 13, 16)]
    with contextlib.ExitStack() as stack:
        simulated = open_simulated(stack, board, "conditions", TwinOptions(mount=NO_MOUNT, is_hurried=True), unit)
        slow_line = replace(simulated.parts, pace=simulated.parts.pace._replace(image_bytes_per_s=2e5))
        b = stack.enter_context(ready_bench(slow_line, board, None))
        collect(b, items, LogWriter(tmp_path / "log.h5", {"board": board.name}))
        with pytest.raises(InputError, match="needs a stage"):
            collect(b, STRAIGHT, LogWriter(tmp_path / "none.h5", {}))
    log = read_log(tmp_path / "log.h5")
    for touch, item in zip(log.touches, items, strict=True):
        a = touch.arrays
        assert tuple(touch.facts["signs"]) == item.signs
        peak = a["reference_wrench"][abs(item.part(a["reference_wrench"])).max(axis=1).argmax()]
        assert np.array_equal(np.sign(peak) * (abs(item.part(peak)) > 0.1), item.signs)
        assert len(a["reference_s"]) > 20  # the whole push, not only its end
        assert a["marker_displacement"].shape[1:] == (3, 3)
        assert len(a["image"]) >= 1
    runs = read_feature_runs([tmp_path / "log.h5"], board)
    features = np.vstack([run.features for run in runs]) / np.tile([65536, 65536, 256], 3)
    wrench = np.vstack([run.at(0.0) for run in runs])
    fitted = features @ np.linalg.lstsq(features, wrench, rcond=None)[0]
    assert np.corrcoef(fitted[:, 2], wrench[:, 2])[0, 1] > 0.9  # pushed down: the targets get larger
