"""A whole bench that is not there: twin as camera, emulated machine that presses it, emulated reference below it."""

from __future__ import annotations

import socket
import struct
import threading
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ruffini.rig.emulated_machine import HOME_PLACE, EmulatedMachine
from ruffini.rig.network_cell import MAGIC, RECORD, REQUEST, STREAM, Settings
from ruffini.rig.stage import Place
from ruffini.sim.indenters import Indenter
from ruffini.sim.pose import Pose
from ruffini.sim.rig import Unit
from ruffini.sim.scenario import Scenario
from ruffini.sim.serve import States, TwinServer

Array = npt.NDArray[np.float64]

ORIGIN = Place(HOME_PLACE.x_m + 0.002, HOME_PLACE.y_m - 0.001, HOME_PLACE.z_m - 0.004)  # of the pad in the machine
FULL_SCALE = np.array([20.0, 20, 20, 0.5, 0.5, 0.5])
SIGMA = np.array([0.005, 0.005, 0.005, 5e-5, 5e-5, 5e-5])
PER_COUNT = np.array([1e-6] * 3 + [1e-8] * 3)
MAX_FORCE_N = 15.0
POLL_S = 0.05


class PressedTwin:
    """Frames of a twin whose indenter hangs on a machine; keeps the true wrench of the newest."""

    def __init__(self, unit: Unit, indenter: Indenter, machine: EmulatedMachine) -> None:
        self._rig, self._machine = unit.rig(), machine
        self._rig.take(indenter)
        self._indenter, self._touches = indenter, False
        self.wrench = np.zeros(6)
        self.is_new = threading.Event()
        self.rate_hz = unit.board.camera.rate_mhz / 1e3

    def states(self, frame: int) -> States | None:
        before = self._rig.displacement.copy()
        place = self._machine.place().minus(ORIGIN)
        if place.z_m < 0:
            self._rig.advance(Pose(place.x_m, place.y_m, -place.z_m))
            self._touches = True
        elif self._touches:  # the next touch begins anew: nothing sticks to what was
            self._rig.take(self._indenter)
            self._touches = False
        self.wrench = self._rig.wrench().copy() if self._touches else np.zeros(6)
        self.is_new.set()
        return self._rig.displacement, before, self._rig.tray


class EmulatedNetworkCell:
    """A force/torque box on loopback: one record of the pad's true wrench a frame, with noise and what hangs on it."""

    def __init__(self, twin: PressedTwin, seed: int, hanging: Array) -> None:
        self._twin, self._hanging = twin, hanging
        self._rng = np.random.default_rng(seed)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self.port = int(self._socket.getsockname()[1])
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="force/torque box", daemon=True)

    def __enter__(self) -> EmulatedNetworkCell:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._socket.close()

    @property
    def settings(self) -> Settings:
        """What its page would say."""
        return Settings(PER_COUNT, "N", "Nm", self._twin.rate_hz)

    def _run(self) -> None:
        peer, sequence = None, 0
        self._socket.setblocking(False)
        while not self._stop.is_set():
            try:
                request, asker = self._socket.recvfrom(64)
                magic, command, _ = REQUEST.unpack(request)
                peer = asker if magic == MAGIC and command == STREAM else None
            except (BlockingIOError, ConnectionRefusedError, struct.error):
                pass
            if self._twin.is_new.wait(POLL_S) and peer is not None:
                self._twin.is_new.clear()
                sequence += 1
                wrench = self._twin.wrench + self._hanging + 0.3 * SIGMA * self._rng.normal(size=6)
                counts = np.round(wrench / PER_COUNT).astype(int).tolist()
                self._socket.sendto(RECORD.pack(sequence, sequence, 0, *counts), peer)


class TwinBench(NamedTuple):
    """Its parts, to be entered in this order."""

    machine: EmulatedMachine
    twin: PressedTwin
    server: TwinServer
    cell: EmulatedNetworkCell


def build_twin_bench(unit: Unit, indenter: Indenter, machine: EmulatedMachine, camera: Path, seed: int) -> TwinBench:
    """A bench whose camera is the UNIX socket `camera`; something of 0.3 N hangs on its reference."""
    twin = PressedTwin(unit, indenter, machine)
    server = TwinServer(unit.renderer(), twin, Scenario(seed=seed), camera)
    return TwinBench(machine, twin, server, EmulatedNetworkCell(twin, seed, np.array([0, 0, -0.3, 0.001, 0, 0])))
