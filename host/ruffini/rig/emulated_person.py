"""An emulated person who follows the programs' instructions on a twin."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from ruffini import host_clock
from ruffini.errors import RefusedError
from ruffini.rig.program import NAMES
from ruffini.rig.twin_bench import Load
from ruffini.rig.units import GRAVITY_M_S2
from ruffini.sim.bodies.connector import hand_load
from ruffini.sim.pose import Pose

Array = npt.NDArray[np.float64]

AT = re.compile(r"x ([-+][\d.]+), y ([-+][\d.]+) mm")
PRESS = re.compile(r"press .*with [\d.]+ N")
PUT = re.compile(r"put ([\d.]+) g")
SCALE = re.compile(r"press at .* until the scale shows about ([\d.]+) g")
AXIS = re.compile(r"([-+])(F[xyz]|T[xyz])")
UP_TO = re.compile(r"up to ([\d.]+) N(?:, pressing ([\d.]+) N,)? and ([\d.]+) N mm")
FIRST_STEP_M, LEAST_STEP_M = 3e-5, 2e-6  # a frame, of a hand that seeks a force
HESITATES = 0.6  # of the step before, each time that it has to turn back
WEIGHT_STEP_M = 1e-4  # a frame, at most, that a weight sinks in
SETTLED = 0.01  # of its weight is not carried yet
STANDS = 0.001  # so little of it, and the weight moves no more
LOAD_FRAMES = 60  # of the twin's camera: a computer that is busy with other things sees a part of them
SOME_PRESSES_N, HOLD_S = (0.6, 1.1, 0.8, 1.4, 0.5, 1.0, 0.7, 1.2), 0.8
PAUSES_S = (0.8, 1.4, 0.6, 1.1, 2.0, 0.7, 1.6, 0.9)  # before each
PATIENCE_S = 120.0
POLL_S = 0.01
REACTION_S = 0.2


class EmulatedPerson:
    """Both ends: hears what is said (`rig.bench.Person`), and presses a twin (`rig.twin_bench.Loader`)."""

    def __init__(self, seed: int, say: Callable[[str], None] = lambda _: None) -> None:
        self._rng, self._echo = np.random.default_rng(seed), say
        self._lock = threading.Lock()
        self._place: tuple[float, float] | None = None
        self._depth_m, self._step_m = 0.0, 0.0
        self._weight_n: float | None = None
        self._last: tuple[float, float] | None = None  # depth and force of the frame before, of a weight
        self._loads: list[Array] = []
        self._felt_n = 0.0
        self.is_obedient = True

    def say(self, text: str) -> None:
        """Hear, and begin to do it."""
        self._echo(text)
        with self._lock:
            if PRESS.match(text):
                self._place, self._depth_m, self._step_m = _place_in(text), 0.0, FIRST_STEP_M
            elif text in ("harder", "softer"):
                self._turn(1.0 if text == "harder" else -1.0)
            elif text in ("hold still", "good"):
                self._step_m = np.copysign(min(abs(self._step_m), LEAST_STEP_M), self._step_m) * 0
            elif text == "let go" or text.startswith("STOP"):
                self._place = None
            elif text.startswith("load "):
                self._loads = list(_loads(text, self._rng))

    def _turn(self, sign: float) -> None:
        step_m = max(abs(self._step_m), FIRST_STEP_M * HESITATES**4)
        has_turned = self._step_m * sign < 0 or self._step_m == 0
        self._step_m = sign * max(step_m * (HESITATES if has_turned else 1.0), LEAST_STEP_M)

    def confirm(self, text: str) -> None:
        """Hear, do it, and come back when it is done; raises RefusedError where it cannot be done."""
        self._echo(text)
        if not self.is_obedient:
            raise RefusedError(f"stopped by a key at {text!r}")
        if "press and let go" in text:
            for pause_s, force_n in zip(PAUSES_S, SOME_PRESSES_N, strict=True):
                host_clock.sleep(pause_s)
                self._carry(force_n, (1e-3 * force_n, -5e-4))
                host_clock.sleep(HOLD_S)
                self._carry(None, None)
            host_clock.sleep(PAUSES_S[0])
            return
        put = PUT.match(text)
        self._carry(1e-3 * float(put[1]) * GRAVITY_M_S2 if put else None, _place_in(text) if put else None)

    def number(self, text: str) -> str:
        """Press on a scale of 1 g, and type what it shows, as some scales do with a comma."""
        self._echo(text)
        wanted = SCALE.search(text)
        if not self.is_obedient or wanted is None:
            raise RefusedError(f"stopped by a key at {text!r}")
        self._carry(1e-3 * float(wanted[1]) * GRAVITY_M_S2, _place_in(text))
        with self._lock:
            return f"{self._felt_n / GRAVITY_M_S2 * 1e3:.0f},0"

    def _carry(self, weight_n: float | None, place: tuple[float, float] | None) -> None:
        """Put a weight somewhere, or take it away; returns when the pad carries it, or nothing."""
        host_clock.sleep(REACTION_S)  # else a frame of the same instant already shows the change
        with self._lock:
            self._weight_n, self._place, self._depth_m, self._last = weight_n, place, 0.0, None
        deadline = host_clock.now() + PATIENCE_S
        while not self._is_settled():
            if host_clock.now() > deadline:
                raise RefusedError(f"a weight of {weight_n} N at {place}: this twin does not carry it")
            host_clock.sleep(POLL_S)

    def _is_settled(self) -> bool:
        with self._lock:
            return abs(self._felt_n - (self._weight_n or 0.0)) <= SETTLED * (self._weight_n or 1.0)

    def load(self, wrench: Array) -> Load:
        with self._lock:
            self._felt_n = float(np.linalg.norm(wrench[:3]))
            if self._loads:
                return self._loads.pop(0)
            if self._place is None:
                return None
            self._depth_m += self._step_m if self._weight_n is None else self._sink()
            return Pose(*self._place, self._depth_m) if self._depth_m > 0 else None

    def _sink(self) -> float:
        """How far a weight goes down in this frame: as much as the stiffness that it met needs."""
        assert self._weight_n is not None
        lacks_n, last = self._weight_n - self._felt_n, self._last
        if abs(lacks_n) <= STANDS * self._weight_n:
            return 0.0
        self._last = (self._depth_m, self._felt_n)
        if last is None or abs(self._depth_m - last[0]) < 1e-8:
            return float(np.sign(lacks_n)) * LEAST_STEP_M * 5
        stiffness = max((self._felt_n - last[1]) / (self._depth_m - last[0]), 50.0)
        return float(np.clip(lacks_n / stiffness, -WEIGHT_STEP_M, WEIGHT_STEP_M))


def _place_in(text: str) -> tuple[float, float]:
    found = AT.search(text)
    return (1e-3 * float(found[1]), 1e-3 * float(found[2])) if found else (0.0, 0.0)


def _loads(text: str, rng: np.random.Generator) -> Array:
    """Wrenches of one push and release as they were asked for, (n, 6)."""
    signs = np.zeros(6)
    for sign, name in AXIS.findall(text):
        signs[NAMES.index(name)] = 1.0 if sign == "+" else -1.0
    largest = UP_TO.search(text)
    assert largest is not None
    force_n, torque_nmm = float(largest[1]), float(largest[3])
    normal_n = float(largest[2] or force_n)
    return hand_load(signs, LOAD_FRAMES, rng, np.array([force_n, force_n, normal_n, *[1e-3 * torque_nmm] * 3]))
