"""`ruffini cal collect` with a bench's file: each program on devices that speak their real protocols on ptys."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
import shutil
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomllib
from test_auto_boards import coarse
from tiny_twin import Twin

from ruffini import host_clock
from ruffini.boards import find_board
from ruffini.calibrate.auto.fingertip import eyes_apart_mm
from ruffini.calibrate.container import read
from ruffini.calibrate.gates import MIN_PRESSES
from ruffini.cli import main
from ruffini.daemon import running_daemon
from ruffini.device import Connection
from ruffini.errors import RefusedError
from ruffini.estimators.contact_model.touches import presses_of_log
from ruffini.estimators.fingertip.log import press_roots
from ruffini.estimators.fingertip.presses import AREA, FORCE, PITCH, ROLL, WAY, X, Y, read_press
from ruffini.estimators.fingertip.task import TASK as FINGERTIP
from ruffini.estimators.task import Counts, Turned
from ruffini.rig.emulated_dialects import EmulatedGrbl, EmulatedMarlin
from ruffini.rig.emulated_machine import EmulatedMachine
from ruffini.rig.emulated_person import EmulatedPerson
from ruffini.rig.emulated_references import EmulatedLogger, EmulatedPacketCell, EmulatedPage, EmulatedTextCell, Mount
from ruffini.rig.found import is_held
from ruffini.rig.frame_clock import FrameClock
from ruffini.rig.log_file import Log, read_log
from ruffini.rig.program import Tool
from ruffini.rig.twin_bench import ORIGIN, Hanging, Load, Loader, build_twin_bench
from ruffini.sim.bodies.dome_unit import DomeUnit
from ruffini.sim.indenters import Indenter, body
from ruffini.sim.pose import Pose
from ruffini.sim.rig import Unit
from ruffini.sim.units import build_unit

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
FEW_PICTURES = 1e5  # bytes a second of simulated time: each sixth frame's, of the tiny twin
STATED_HZ = 0.1  # of a reference by simulated time: how long its silence is waited for is real time


class Desk:
    """A sensor, whatever presses it, and a person at the terminal."""

    def __init__(
        self, twin: Twin, folder: Path, loader: Loader, capsys: pytest.CaptureFixture[str], step: int = 1
    ) -> None:
        self.twin, self.folder, self._capsys = twin, folder, capsys
        self.clock = FrameClock(1e3 / twin.board.camera.rate_mhz, step=step)
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
        bench = ("--board", self.twin.board.folder, "--rig", self.folder / "rig.toml")
        return self.cal(monkeypatch, verb, *bench, *words)

    def cal(self, monkeypatch: pytest.MonkeyPatch, verb: str, *words: object) -> tuple[int, str, str]:
        """The same without a bench."""
        argv = ["ruffini", "--port", self.port, "cal", verb, "--json", *words]
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
    monkeypatch.setattr("ruffini.rig.session.Pace.__new__.__defaults__", (None, 60.0, 8.0, 30.0, FEW_PICTURES))


@pytest.fixture
def person(monkeypatch: pytest.MonkeyPatch) -> Iterator[EmulatedPerson]:
    """Hears what the verb writes, does it, and presses Enter."""
    reader, writer = os.pipe()
    someone = EmulatedPerson(1)

    def hear(text: str) -> None:
        asked, has_to_answer, _ = text.partition(", then press Enter")
        if not has_to_answer:
            return someone.say(asked)
        try:
            someone.confirm(asked)
        except RefusedError:
            os.write(writer, b"x")
        else:
            os.write(writer, b"\n")

    for verb in ("collect", "auto", "check"):
        monkeypatch.setattr(f"ruffini.cli.{verb}.note", hear)
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
        desk.bench.cell.loses_each = 5  # of ten in the second that the check counts, so one at least is lost in it
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
            words = ("--n", 3, "--depth-mm", 0.5, "--shear-mm", 0.5, "--out", tmp_path / "log.h5")
            code, _, said = desk.run(
                monkeypatch, rig + LIMITS, "collect", "--calibration", tmp_path / "calibration", *words
            )
        assert code == 0, said
    log = read_log(tmp_path / "log.h5")
    for touch in log.touches:
        truth = touch.arrays["reference_wrench"][is_held(touch.arrays["reference_s"], touch.facts)].mean(axis=0)
        assert truth[2] < -0.09
        shear = np.array([touch.facts["shear_x_m"], touch.facts["shear_y_m"]])
        if shear.any():
            assert truth[:2] @ shear > 0.9 * np.linalg.norm(truth[:2]) * np.linalg.norm(shear)
    n_lost = [touch.facts["lost_packets"] for touch in log.touches]
    assert log.found["reference"]["lost_packets"] == sum(n_lost)
    for touch, n in zip(log.touches, n_lost, strict=True):
        assert n == pytest.approx(len(touch.arrays["reference_s"]) / 4, abs=1.5)
    assert "packets lost or damaged: " in log.found["checks"]["rate"]["text"]
    assert "packets of the reference lost or damaged: " in said


def test_weights(bench_twin: Twin, tmp_path, monkeypatch, capsys, person, slow_is_fine) -> None:
    desk = Desk(bench_twin, tmp_path, person, capsys)
    with desk.running():
        _, log = desk.collect(monkeypatch, '[reference]\nkind = "weight"\nsigma_g = 0.1\n' + LIMITS,
                              "--program", "weights", "--grams", "40,90", "--n", 2)  # fmt: skip
        given = ("--grams", 60, "--calibration", tmp_path / "calibration")
        code, checked, said = desk.cal(monkeypatch, "check", *given)
    assert "a person tells" in log.found["checks"]["rate"]["text"]
    assert code in (0, 1), said  # the coarse pad may not meet what gates ask of a real one
    assert json.loads(checked)["wanted"] == pytest.approx(60 / GRAMS_A_NEWTON)
    assert json.loads(checked)["said"] == pytest.approx(60 / GRAMS_A_NEWTON, rel=0.3)
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


def test_presses_by_hand_on_a_box_that_sends_packets(
    bench_twin: Twin, tmp_path, monkeypatch, capsys, person, slow_is_fine
) -> None:
    with EmulatedPacketCell(1) as cell:
        desk = Desk(bench_twin, tmp_path, person, capsys)
        desk.bench.twin.listeners.append(cell.measure)
        rig = f"""[reference]
kind = "m8128"
port = "{cell.port}"
rate_hz = 1
full_scale = [20.0, 20.0, 20.0, 0.5, 0.5, 0.5]
sigma = [0.005, 0.005, 0.005, 0.00005, 0.00005, 0.00005]
"""
        with desk.running():
            _, log = desk.collect(monkeypatch, rig + LIMITS, "--program", "free", "--force-n", 0.8, "--n", 2)
    assert cell.asked[1] == "AT+SMPF=1"
    assert log.found["reference"]["axes"] == ["fx", "fy", "fz", "tx", "ty", "tz"]
    for touch in log.touches:
        assert -held(touch, "reference_wrench", "reference_s") == pytest.approx(touch.facts["force_n"], rel=0.25)


def test_a_csv_of_another_programs_voltages(
    bench_twin: Twin, tmp_path, monkeypatch, capsys, person, slow_is_fine
) -> None:
    desk = Desk(bench_twin, tmp_path, person, capsys)
    matrix = np.diag([5.0, 5, 5, 0.5, 0.5, 0.5]) + np.random.default_rng(3).normal(size=(6, 6)) / 20
    logger = EmulatedLogger(tmp_path / "force.csv", 1, offset_s=77.0, matrix=matrix)
    desk.bench.twin.listeners.append(logger.measure)
    gauges = f"columns = {[f'G{i}' for i in range(6)]}\nmatrix = {matrix.tolist()}\n"
    with desk.running():
        result, log = desk.collect(
            monkeypatch,
            f'[reference]\nkind = "csv"\npath = "{tmp_path}/force.csv"\n{gauges}{LIMITS}',
            "--program",
            "log",
        )
    assert result["touches"] == len(log.touches) >= 6
    for touch in log.touches:
        truth = held(touch, "reference_wrench", "reference_s")
        assert held(touch, "stream_wrench", "stream_host_s") == pytest.approx(truth, rel=0.3)


class Changed(Hanging):
    """What a person mounts on the machine: each indenter ends elsewhere."""

    length_m = 0.0

    def load(self, wrench: np.ndarray) -> Pose | None:
        place = self._machine.place().minus(ORIGIN)
        depth_m = self.length_m - place.z_m
        return Pose(place.x_m, place.y_m, depth_m) if depth_m > 0 else None


MOUNT = re.compile(r"mount indenter (\w+) ")
TILT = re.compile(r"outer axis ([-+][\d.]+), inner axis ([-+][\d.]+) degrees")
SIZES_MM = (11.0, 10.8, 10.5, 10.3, 10.0, 9.6, 9.2, 8.8, 8.5)
FACES = ("square", "flat", "triangle", "square", "flat", "square", "flat", "square", "flat")
FACES_SHORE, BALLS_SHORE = (60, 28, 68, 36, 76, 44, 85, 52, 20), (76, 60, 44, 28, 85, 68, 52, 36, 20)
NAMES = [f"{kind}{i}" for kind in "AB" for i in range(len(SIZES_MM))]
INDENTERS = "".join(
    f'[[indenters]]\nname = "{name}"\nshape = "{shape}"\nsize_mm = {size_mm}\nshore_a = {shore:.1f}\n'
    for name, shape, size_mm, shore in zip(
        NAMES, [*FACES, *["sphere"] * len(SIZES_MM)], SIZES_MM * 2, FACES_SHORE + BALLS_SHORE, strict=True
    )
)
LENGTHS_M = {name: 1e-4 * (7 * i % 16 - 6) for i, name in enumerate(NAMES)}


class Both:
    """A person who puts weights, or what hangs on the machine."""

    def __init__(self, person: EmulatedPerson, held: Hanging) -> None:
        self._person, self._held = person, held

    def load(self, wrench: np.ndarray) -> Load:
        by_hand = self._person.load(wrench)
        return self._held.load(wrench) if by_hand is None else by_hand


class ChangedDesk(Desk):
    """A board on a stage and six axes; a person mounts and turns what they are told."""

    listed = INDENTERS

    def __init__(
        self, unit: Unit, held: Hanging, folder: Path, machine: EmulatedMachine, page: EmulatedPage,
        person: EmulatedPerson, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, step: int,
    ) -> None:  # fmt: skip
        self.told, self.sentences = list[str](), list[str]()
        self.leaves_at, self._confirm = "", person.confirm
        monkeypatch.setattr(person, "confirm", self.mount)
        super().__init__(Twin(unit, b""), folder, Both(person, held), capsys, step)
        origin = ", ".join(f"{1e3 * v:.3f}" for v in ORIGIN)
        self.rig = f"""[reference]
kind = "network"
host = "127.0.0.1"
port = {self.bench.cell.port}
http_port = {page.server_port}
full_scale = [20.0, 20.0, 20.0, 0.5, 0.5, 0.5]
sigma = [0.005, 0.005, 0.005, 0.00005, 0.00005, 0.00005]
[stage]
kind = "marlin"
port = "{machine.port}"
origin_mm = [{origin}]
{self.listed}[limits]
max_force_n = 15.0
half_x_mm = 7.0
half_y_mm = 7.0
top_mm = 3.0
bottom_mm = -4.0
deepest_mm = 1.7
near_mm = 0.3
"""

    def mount(self, asked: str) -> None:
        found = MOUNT.match(asked)
        if found is None and TILT.search(asked) is None:
            return self._confirm(asked)
        self.sentences.append(asked)
        self.told.append(found[1] if found else "turned")
        if self.told[-1] == self.leaves_at:
            raise RefusedError("out for lunch")
        if found is not None:
            (one,) = (row for row in tomllib.loads(self.listed)["indenters"] if row["name"] == found[1])
            self.change(found[1], one)
        return None

    def change(self, name: str, one: dict[str, Any]) -> None:
        raise NotImplementedError


class GlitterDesk(ChangedDesk):
    """contact-glitter with fewer elements, as many as its gate of hardness needs."""

    def __init__(self, step: int, folder: Path, machine: EmulatedMachine, *others: Any) -> None:
        unit = build_unit(coarse("contact-glitter", folder, "cells_x = 16\ncells_y = 12"))
        self.held = Changed(machine, unit, Indenter("sphere", 0.003))
        super().__init__(unit, self.held, folder, machine, *others, step=step)

    def change(self, name: str, one: dict[str, Any]) -> None:
        self.held.length_m = LENGTHS_M[name]
        self.bench.twin.mount(Tool(one["shape"], one["size_mm"] / 2e3, one["shore_a"]))


@pytest.fixture
def glitter(request, tmp_path, monkeypatch, capsys, person, slow_is_fine) -> Iterator[GlitterDesk]:
    step, n_cells = getattr(request, "param", (3, body.N_CELLS_SYMMETRIC))
    monkeypatch.setattr(body, "N_CELLS_SYMMETRIC", n_cells)
    body._solved.cache_clear()
    with EmulatedMarlin() as machine, EmulatedPage(STATED_HZ) as page:
        desk = GlitterDesk(step, tmp_path, machine, page, person, capsys, monkeypatch)
        with desk.running(), desk.bench.cell:
            yield desk
    body._solved.cache_clear()


# Half the frames, and rubber of few elements, which the reference feels as the pad does.
@pytest.mark.parametrize("glitter", [(6, 8)], indirect=True)
def test_a_person_mounts_indenters_leaves_and_goes_on(glitter: GlitterDesk, monkeypatch) -> None:
    out = glitter.folder / "log.h5"
    words = ("collect", "--out", out, "--program", "indenters", "--n", 2, "--depth-mm", 0.5)
    glitter.leaves_at = "B0"
    code, _, said = glitter.run(monkeypatch, glitter.rig, *words)
    assert (code, "stopped by a key at 'mount indenter B0 (sphere of 11.0 mm, Shore A 76)" in said) == (4, True)
    glitter.leaves_at = ""
    code, text, said = glitter.run(monkeypatch, glitter.rig, *words)
    assert code == 0, said
    assert json.loads(text)["kept"] == 1
    assert glitter.told == ["A0", "B0", "B0"]
    log = read_log(out)
    assert log.facts["tip"] is None
    assert [one["name"] for one in log.facts["indenters"]] == list(LENGTHS_M)
    for touch, name in zip(log.touches, ("A0", "B0"), strict=True):
        assert touch.facts["tool"]["name"] == name
        assert abs(touch.facts["contact_z_m"]) < 2.1e-4  # counted from where this indenter touched
        assert np.ptp(touch.arrays["stage_place"][:, 2]) == pytest.approx(5e-4)
        assert touch.arrays["reference_wrench"][:, 2].min() < -0.2
    presses = presses_of_log(out, glitter.twin.board)
    assert [(p.shape, p.radius_mm, p.shore_a) for p in presses] == [("square", 5.5, 60), ("sphere", 5.5, 76)]


FLAT_TOOLS = """[[indenters]]
name = "T1"
shape = "flat"
size_mm = 8.0
[[indenters]]
name = "T2"
shape = "square"
size_mm = 11.0
[holder]
tilts_deg = [[30.0, -20.0], [0.0, 0.0]]
pivot_mm = 30.0
"""


class TurnedTip(Hanging):
    """A fingertip in a holder whose axes meet 8 mm below the middle of its sphere, under flat tools."""

    above_m = 8e-3

    def __init__(self, machine: EmulatedMachine, unit: DomeUnit) -> None:
        super().__init__(machine, unit, Indenter("flat", 4e-3))
        self.radius_m, self._rig = unit.model.radius_m, unit.rig()
        self.mount(Indenter("flat", 4e-3))
        self.set_rad = (0.0, 0.0)  # roll and pitch, by a person
        self.deepest = Pose(0.0, 0.0, 0.0)  # while what is mounted now was

    def mount(self, tool: Indenter) -> None:
        self.tool = tool
        self._rig.take(tool)

    @property
    def tilt_rad(self) -> tuple[float, float]:
        """Of the tool in the fingertip's axes; the stage's axes of a five-axis machine are A and -B."""
        by_stage = self._machine.turned
        return (-np.deg2rad(by_stage["A"]), np.deg2rad(by_stage["B"])) if by_stage else self.set_rad

    @property
    def turn(self) -> np.ndarray:
        """From the stage's axes to the fingertip's."""
        return Pose(0, 0, 0, 0, *self.tilt_rad).rotation()

    def load(self, wrench: np.ndarray) -> Pose | None:
        up = np.array([0, 0, self.above_m])
        place = np.array(self._machine.place().minus(ORIGIN)) - (self.turn.T @ up - up)
        if np.hypot(*place[:2]) > 0.8 * self.radius_m:
            return None
        pose = Pose(place[0], place[1], 0.0, 0.0, *self.tilt_rad)
        middle = np.array([0, 0, -self.radius_m])
        first = float((self.turn.T @ (self._rig.grip(self.tool, pose).tip - middle))[2]) - self.radius_m
        if place[2] > first:
            return None
        pose = replace(pose, depth_m=first - place[2])
        self.deepest = max(self.deepest, pose, key=lambda one: one.depth_m)
        return pose


class TipDesk(ChangedDesk):
    """stereo-fingertip with few elements, whose reference is in the stage's axes."""

    listed = FLAT_TOOLS
    n_cells = 8

    def __init__(self, folder: Path, machine: EmulatedMachine, *others: Any) -> None:
        shutil.copytree(find_board("stereo-fingertip").folder, folder / "stereo-fingertip")
        twin = folder / "stereo-fingertip" / "twin.toml"
        text = twin.read_text()
        changes = {"cells = 18": f"cells = {self.n_cells}"}
        if not machine.turned:  # by hand a single press is made: what is held looks the same from frame to frame
            changes |= {"n_leds = 8": "n_leds = 3", "relax_1e3 = [80, 70, 60]": "relax_1e3 = []",
                        "relax_ms = [300, 3000, 30000]": "relax_ms = []"}  # fmt: skip
        for old, new in changes.items():
            assert old in text, old
            text = text.replace(old, new)
        twin.write_text(text)
        unit = build_unit(find_board(folder / "stereo-fingertip"))
        self.held = TurnedTip(machine, unit)
        if machine.turned:
            self.listed += 'axes = ["A", "-B"]\n'
        super().__init__(unit, self.held, folder, machine, *others, step=15)
        cell = self.bench.cell
        self.bench.twin.listeners[:] = [
            lambda frame, w: cell.measure(frame, np.append(self.held.turn.T @ w[:3], w[3:]))
        ]

    def mount(self, asked: str) -> None:
        super().mount(asked)
        if (found := TILT.search(asked)) is not None:
            self.held.set_rad = tuple(-np.deg2rad([float(found[1]), float(found[2])]))

    def change(self, name: str, one: dict[str, Any]) -> None:
        self.held.mount(Indenter(one["shape"], one["size_mm"] / 2e3))
        self.bench.twin._indenter = self.held.tool


@pytest.fixture
def tip(request, tmp_path, monkeypatch, capsys, person) -> Iterator[TipDesk]:
    # The picture of every second frame comes along.
    monkeypatch.setattr("ruffini.rig.session.Pace.__new__.__defaults__", (None, 60.0, 8.0, 30.0, 7e6))
    with EmulatedMarlin(turns=getattr(request, "param", "")) as machine, EmulatedPage(STATED_HZ) as page:
        desk = TipDesk(tmp_path, machine, page, person, capsys, monkeypatch)
        with desk.running(), desk.bench.cell:
            yield desk


def test_a_person_turns_a_fingertip_under_flat_tools(tip: TipDesk, monkeypatch) -> None:
    out, board = tip.folder / "log.h5", tip.twin.board
    code, _, said = tip.run(monkeypatch, tip.rig, "collect", "--out", out, "--n", 1, "--depth-mm", 0.4)
    assert code == 0, said
    assert tip.sentences == [
        "mount indenter T1 (flat of 8.0 mm, Shore A 98), turn the holder to outer axis -30, inner axis +20 degrees, "
        "and take your hands off"
    ]
    (touch,), true = read_log(out).touches, tip.held.deepest
    assert touch.facts["tilt_deg"] == [30.0, -20.0]
    with press_roots([out], board) as (root,):
        press = read_press(board, root / "00000")
    assert np.isnan(press.told[:2]).all()
    assert press.told[-1, [WAY, X, Y]] == pytest.approx(1e3 * np.array([true.depth_m, true.x_m, true.y_m]), abs=0.05)
    assert press.told[-1, [ROLL, PITCH, AREA]] == pytest.approx([30, -20, 16 * np.pi])
    assert (np.diff(press.told[2:-1, FORCE]) > 0.03).all()  # N, at stops 0.1 mm apart
    pins_px = np.abs(press.moved).max(axis=(1, 2, 3))
    assert pins_px[:2].max() < 0.1 < 1.0 < pins_px[-1]


def judged_again(
    desk: ChangedDesk, monkeypatch: pytest.MonkeyPatch, auto: Path, *words: object, few: dict[str, float]
) -> dict[str, Any]:
    """Fit, report, flash, check and undo with the logs that `cal auto` kept; what `check` found.

    few : gates that the judged touches, which are few, fail.
    """
    unit, page, board = desk.folder / "unit.safetensors", desk.folder / "page.html", desk.twin.board.folder
    before = read(auto / "calibration.safetensors")
    code, text, said = desk.cal(monkeypatch, "fit", auto / "fitted.h5", "--board", board, "--out", unit, *words)
    assert (code, failing(json.loads(text))) == (0, {}), said
    assert read(unit).tensors.keys() == before.tensors.keys()
    for log, is_fitted, fails in (("fitted.h5", True, {}), ("after.h5", False, few)):
        words = ("--log", auto / log, "--board", board, "--previous", auto / "calibration.safetensors", "--out", page)
        code, text, said = desk.cal(monkeypatch, "report", unit, *words)
        judged = json.loads(text)
        assert (code, failing(judged)) == (1 if fails else 0, fails), said
        assert (judged["log"]["in_the_fit"], judged["log"]["simulated"]) == (is_fitted, False)
        told = page.read_text()
        assert ("FAILS: " + "; ".join(fails) if fails else "Passes its gates") in told
        assert "data:image/png" in told
        assert "SIMULATED" not in told
    code, text, said = desk.cal(monkeypatch, "flash", unit, "--backup", desk.folder / "kept")
    assert (code, json.loads(text)["state"]) == (0, "active"), said
    code, text, said = desk.cal(monkeypatch, "check", "--grams", 60, "--calibration", unit)
    assert code == 0, said
    checked = json.loads(text)
    code, _, said = desk.cal(monkeypatch, "undo")
    assert code == 0, said
    with Connection(desk.port) as sensor:
        assert sensor.hello.sensors[0].calibration.sha256 == before.sha256
    return dict(checked)


def failing(result: dict[str, Any]) -> dict[str, float]:
    """Gates that refuse, with what was measured."""
    return {gate["name"]: gate["value"] for gate in result["gates"] if gate["ok"] is False}


@pytest.mark.long
@pytest.mark.parametrize("tip", ["AB"], indirect=True)
def test_auto_on_a_fingertip_that_a_five_axis_stage_turns(tip: TipDesk, monkeypatch) -> None:
    few = replace(FINGERTIP, quick=Counts(0, MIN_PRESSES, 2, 0))
    monkeypatch.setattr("ruffini.estimators.fingertip.stage.Fingertip.task", Turned("fingertip", "", few.unit, few))
    out = tip.folder / "auto"
    code, text, said = tip.run(monkeypatch, tip.rig, "auto", "--quick", "--out", out, "--depth-mm", 0.7)
    assert code == 0, said
    result = json.loads(text)
    assert tip.told == ["T1", "T2", "T1", "T2"]  # fitted, then judged; a person mounts the tools alone
    assert {tuple(touch.facts["tilt_deg"]) for touch in read_log(out / "fitted.h5").touches} == {(30.0, -20.0), (0, 0)}
    assert failing(result) == {}
    assert (result["simulated"], result["after"]["against"], result["after"]["touches"]) == (False, "the reference", 2)
    assert result["after"]["told"] > 0.5 * result["after"]["frames"]
    assert result["after"]["error"] < 75  # mN
    assert (out / "report.html").exists()
    with Connection(tip.port) as sensor:
        assert sensor.hello.sensors[0].calibration.sha256.hex() == result["sha256"]
    checked = judged_again(tip, monkeypatch, out, "--baseline-mm", eyes_apart_mm(tip.twin.board), few={"presses": 2})
    assert (checked["simulated"], checked["ok"]) == (False, True)
    assert checked["allowed"] < 0.2  # N: as its report states


@pytest.mark.long
def test_auto_on_indenters_that_a_person_mounts(glitter: GlitterDesk, monkeypatch) -> None:
    out = glitter.folder / "auto"
    code, text, said = glitter.run(monkeypatch, glitter.rig, "auto", "--quick", "--out", out)
    assert code == 0, said
    result = json.loads(text)
    assert glitter.told == [*NAMES, "A0", "A3", "A6", "B0", "B3", "B6"]  # fitted, then judged
    assert failing(result) == {}
    assert (result["simulated"], result["after"]["against"], result["after"]["touches"]) == (False, "the reference", 6)
    assert result["after"]["error"] < 10  # % of the largest normal force
    assert (out / "report.html").exists()
    with Connection(glitter.port) as sensor:
        assert sensor.hello.sensors[0].calibration.sha256.hex() == result["sha256"]
    checked = judged_again(glitter, monkeypatch, out, few={})
    assert (checked["simulated"], checked["ok"]) == (False, True)
    assert checked["allowed"] < 0.5  # N: as its report states, of objects of shapes left out


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
