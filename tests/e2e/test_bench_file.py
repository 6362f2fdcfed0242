"""`ruffini cal collect` with a bench's file: each program on devices that speak their real protocols on ptys."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from tiny_twin import Twin

from ruffini import host_clock
from ruffini.cli import main
from ruffini.daemon import running_daemon
from ruffini.device import Connection
from ruffini.rig.emulated_dialects import EmulatedGrbl, EmulatedMarlin
from ruffini.rig.emulated_person import EmulatedPerson
from ruffini.rig.emulated_references import EmulatedLogger, EmulatedPage, EmulatedTextCell, Mount
from ruffini.rig.found import is_held
from ruffini.rig.frame_clock import FrameClock
from ruffini.rig.log_file import Log, read_log
from ruffini.rig.twin_bench import ORIGIN, Hanging, Loader, build_twin_bench
from ruffini.sim.indenters import Indenter

LIMITS = """[limits]
max_force_n = 5.0
half_x_mm = 4.0
half_y_mm = 3.0
top_mm = 2.0
bottom_mm = -1.5
deepest_mm = 0.8
near_mm = 0.3
"""
TEXT = '[reference]\nkind = "text"\nport = "{port}"\nunit = "g"\nfull_scale_n = 20.0\nsigma_n = 0.005\nrate_hz = 2.0\n'
GRAMS_A_NEWTON = 1e3 / 9.80665


class Desk:
    """A sensor, whatever presses it, and a person at the terminal."""

    def __init__(self, twin: Twin, folder: Path, loader: Loader, capsys: pytest.CaptureFixture[str]) -> None:
        self.twin, self.folder, self._capsys = twin, folder, capsys
        self.clock = FrameClock(1e3 / twin.board.camera.rate_mhz)
        self.bench = build_twin_bench(
            twin.unit, Indenter("sphere", 0.003), loader, folder / "twin", 1, clock=self.clock
        )
        self.port = ""

    @contextlib.contextmanager
    def running(self) -> Iterator[Desk]:
        assert self.twin.board.folder is not None
        camera = f"twin:{self.folder / 'twin'}"
        with (
            host_clock.lent(self.clock),
            self.bench.server,
            running_daemon(self.twin.board.folder, camera, self.folder / "store", "--lockstep") as self.port,
        ):
            (self.folder / "calibration").write_bytes(self.twin.calibration)
            try:
                yield self
            finally:
                self.clock.stop()

    def run(self, monkeypatch: pytest.MonkeyPatch, rig: str, verb: str, *words: object) -> tuple[int, str, str]:
        """Run a verb of `cal` as a person would: exit code, what it printed, what it said."""
        (self.folder / "rig.toml").write_text("schema = 1\n" + rig)
        argv = ["ruffini", "--port", self.port, "cal", verb, "--board", self.twin.board.folder, "--json",
                "--rig", self.folder / "rig.toml", *words]  # fmt: skip
        monkeypatch.setattr(sys, "argv", [str(word) for word in argv])
        self._capsys.readouterr()
        code = main()
        return (code, *self._capsys.readouterr())

    def collect(self, monkeypatch: pytest.MonkeyPatch, rig: str, *words: object) -> tuple[dict[str, object], Log]:
        """Its result and its log."""
        out = self.folder / "log.h5"
        calibration = self.folder / "calibration"
        code, text, error = self.run(monkeypatch, rig, "collect", "--out", out, "--calibration", calibration, *words)
        assert code == 0, error
        return json.loads(text), read_log(out)


def held(touch, name: str, clock: str) -> float:
    """Mean normal force of a touch's hold."""
    return float(touch.arrays[name][is_held(touch.arrays[clock], touch.facts), 2].mean())


@pytest.fixture
def slow_is_fine(monkeypatch: pytest.MonkeyPatch) -> None:
    """The twin shares its computer with everything else."""
    monkeypatch.setattr("ruffini.rig.session.Pace.__new__.__defaults__", (None, 15.0, 8.0, 30.0, 1e6))


@pytest.fixture
def person(monkeypatch: pytest.MonkeyPatch) -> Iterator[EmulatedPerson]:
    """Hears what the verb writes, does it, and presses Enter."""
    reader, writer = os.pipe()
    someone = EmulatedPerson(1)

    def hear(text: str) -> None:
        asked, has_to_answer, _ = text.partition(", then press Enter")
        (someone.confirm if has_to_answer else someone.say)(asked)
        if has_to_answer:
            os.write(writer, b"\n")

    monkeypatch.setattr("ruffini.cli.collect.note", hear)
    with os.fdopen(reader) as keyboard:
        monkeypatch.setattr(sys, "stdin", keyboard)
        yield someone
    os.close(writer)


def test_a_stage_and_a_cell_that_prints_grams(bench_twin: Twin, tmp_path, monkeypatch, capsys, slow_is_fine) -> None:
    with EmulatedMarlin() as machine, EmulatedTextCell(1, unit="g", per_newton=GRAMS_A_NEWTON) as cell:
        desk = Desk(bench_twin, tmp_path, Hanging(machine, bench_twin.unit, Indenter("sphere", 0.003)), capsys)
        desk.bench.twin.listeners.append(cell.measure)
        origin = ", ".join(f"{1e3 * v:.3f}" for v in ORIGIN)
        stage = f'[stage]\nkind = "marlin"\nport = "{machine.port}"\norigin_mm = [{origin}]\n'
        tip = '[tip]\nshape = "sphere"\ndiameter_mm = 6.0\n'
        with desk.running():
            result, log = desk.collect(monkeypatch, TEXT.format(port=cell.port) + stage + tip + LIMITS,
                                       "--program", "balls", "--n", 3, "--depth-mm", 0.5)  # fmt: skip
    assert (result["state"], result["touches"], result["simulated"]) == ("complete", 3, False)
    assert log.facts["tip"] == {"shape": "sphere", "radius_m": 0.003}
    assert log.found["checks"]["unit"]["ok"]
    assert log.found["reference"]["axes"] == ["fz"]
    for touch in log.touches:
        assert np.isnan(touch.arrays["reference_wrench"][:, 0]).all()
        truth = held(touch, "reference_wrench", "reference_s")
        assert held(touch, "stream_wrench", "stream_host_s") == pytest.approx(truth, rel=0.3)


def test_six_axes_over_the_network_that_stand_turned(
    bench_twin: Twin, tmp_path, monkeypatch, capsys, slow_is_fine
) -> None:
    with EmulatedGrbl() as machine, EmulatedPage(4.0) as page:
        desk = Desk(bench_twin, tmp_path, Hanging(machine, bench_twin.unit, Indenter("sphere", 0.003)), capsys)
        desk.bench.cell.mount = Mount((0.0, 0.0, 90.0))  # the pad's x is its y
        origin = ", ".join(f"{1e3 * v:.3f}" for v in ORIGIN)
        rig = f"""[reference]
kind = "network"
host = "127.0.0.1"
port = {desk.bench.cell.port}
http_port = {page.server_port}
axes = ["+y", "-x", "+z"]
full_scale = [20.0, 20.0, 20.0, 0.5, 0.5, 0.5]
sigma = [0.005, 0.005, 0.005, 0.00005, 0.00005, 0.00005]
[stage]
kind = "grbl"
port = "{machine.port}"
origin_mm = [{origin}]
"""
        with desk.running(), desk.bench.cell:
            _, log = desk.collect(monkeypatch, rig + LIMITS, "--n", 3, "--depth-mm", 0.5, "--shear-mm", 0.5)
    for touch in log.touches:
        truth = touch.arrays["reference_wrench"][is_held(touch.arrays["reference_s"], touch.facts)].mean(axis=0)
        assert truth[2] < -0.09
        shear = np.array([touch.facts["shear_x_m"], touch.facts["shear_y_m"]])
        if shear.any():
            assert truth[:2] @ shear > 0.9 * np.linalg.norm(truth[:2]) * np.linalg.norm(shear)


def test_weights(bench_twin: Twin, tmp_path, monkeypatch, capsys, person, slow_is_fine) -> None:
    desk = Desk(bench_twin, tmp_path, person, capsys)
    with desk.running():
        _, log = desk.collect(monkeypatch, '[reference]\nkind = "weight"\nsigma_g = 0.1\n' + LIMITS,
                              "--program", "weights", "--grams", "40,90", "--n", 2)  # fmt: skip
    for touch, grams in zip(log.touches, (40, 90), strict=True):
        weight_n = grams / GRAMS_A_NEWTON
        assert held(touch, "reference_wrench", "reference_s") == pytest.approx(-weight_n, rel=1e-6)
        assert held(touch, "stream_wrench", "stream_host_s") == pytest.approx(-weight_n, rel=0.3)


def test_presses_by_hand(bench_twin: Twin, tmp_path, monkeypatch, capsys, person, slow_is_fine) -> None:
    with EmulatedTextCell(1, unit="g", per_newton=GRAMS_A_NEWTON) as cell:
        desk = Desk(bench_twin, tmp_path, person, capsys)
        desk.bench.twin.listeners.append(cell.measure)
        with desk.running():
            _, log = desk.collect(monkeypatch, TEXT.format(port=cell.port) + LIMITS,
                                  "--program", "free", "--force-n", 0.8, "--n", 2)  # fmt: skip
    for touch in log.touches:
        assert -held(touch, "reference_wrench", "reference_s") == pytest.approx(touch.facts["force_n"], rel=0.25)


def test_a_csv_of_another_program(bench_twin: Twin, tmp_path, monkeypatch, capsys, person, slow_is_fine) -> None:
    desk = Desk(bench_twin, tmp_path, person, capsys)
    desk.bench.twin.listeners.append(EmulatedLogger(tmp_path / "force.csv", 1, offset_s=77.0).measure)
    with desk.running():
        result, log = desk.collect(monkeypatch, f'[reference]\nkind = "csv"\npath = "{tmp_path}/force.csv"\n' + LIMITS,
                                   "--program", "log")  # fmt: skip
    assert result["touches"] == len(log.touches) >= 6
    for touch in log.touches:
        truth = held(touch, "reference_wrench", "reference_s")
        assert held(touch, "stream_wrench", "stream_host_s") == pytest.approx(truth, rel=0.3)


def test_auto_replaces_no_calibration_that_nobody_could_put_back(
    bench_twin: Twin, tmp_path, monkeypatch, capsys
) -> None:
    ball = '[tip]\nshape = "sphere"\ndiameter_mm = 6.0\n'
    rig = TEXT.format(port=tmp_path / "no-cell") + ball + LIMITS  # it gets no further than to the missing reference
    desk = Desk(bench_twin, tmp_path, EmulatedPerson(1), capsys)
    with desk.running():
        with Connection(desk.port) as sensor:
            sensor.flash(bench_twin.calibration)
        auto = ("auto", "--quick", "--out", tmp_path / "auto")
        code, _, said = desk.run(monkeypatch, rig, *auto)
        assert (code, "--previous" in said) == (4, True)
        for word in (("--previous", tmp_path / "calibration"), ("--force",)):
            code, _, said = desk.run(monkeypatch, rig, *auto, *word)
            assert (code, "no-cell" in said) == (3, True), said
        with Connection(desk.port) as sensor:
            assert sensor.hello.sensors[0].calibration.sha256 == hashlib.sha256(bench_twin.calibration).digest()
