"""A guarded stage above a pad: soft limits, force limits, slow approach, and a safe retreat after every failure."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ruffini import host_clock
from ruffini.errors import InputError, NoDeviceError, RefusedError, RuffiniError
from ruffini.rig.contact_surface import ContactSurface
from ruffini.rig.stage import Guard, Place, Stage, no_guard

Array = npt.NDArray[np.float64]
ForceOf = Callable[[], Array]  # force ON the pad, (3,) or more, N; NaN where it is not measured

TRAVEL_M_S, APPROACH_M_S, PRESS_M_S = 0.030, 0.010, 0.001  # sideways above the pad, down to it, into it
CONTACT_N = 0.09
STEP_M = 1e-4
APPROACH_STEP_M = 2e-4  # what a machine that cannot be stopped within a move still goes
MOST_STEPS = 20  # of a press: a deep one is made in longer steps, at most APPROACH_STEP_M each
FREE_STEPS = 4  # before the one that found the contact: a soft pad gives way before it pushes back with CONTACT_N
LOST_STEPS_M = 1e-4  # the pad is not where it was
NEAR_M = 3e-4  # above a contact that is known: from there on in small steps


@dataclass(frozen=True)
class Limits:
    """Limits of the tip's position, from the pad's centre on its undeformed surface, and of its force."""

    half_x_m: float
    half_y_m: float
    top_m: float
    bottom_m: float  # below the surface where the first contact is looked for: negative
    deepest_m: float  # below the contact: positive
    max_force_n: float
    near_m: float = float("inf")  # above the surface: higher up nothing can be touched, one move leads there

    def check(self, place: Place) -> None:
        """Raises RefusedError if a position is outside the limits."""
        if abs(place.x_m) > self.half_x_m or abs(place.y_m) > self.half_y_m:
            raise RefusedError(f"{place} is beside the pad: within +-{1e3 * self.half_x_m:g} x "
                               f"+-{1e3 * self.half_y_m:g} mm only")  # fmt: skip
        if not self.bottom_m <= place.z_m <= self.top_m:
            raise RefusedError(f"{place} is out of the soft limits: z between {1e3 * self.bottom_m:g} and "
                               f"{1e3 * self.top_m:g} mm only")  # fmt: skip


def force_guard(name: str, force_of: ForceOf, max_force_n: float) -> Guard:
    """A guard that raises RefusedError if a force exceeds its limit."""

    def check() -> None:
        force_n = float(np.linalg.norm(np.nan_to_num(force_of()[:3])))
        if force_n > max_force_n:
            raise RefusedError(
                f"{name} measures {force_n:.2f} N, more than the {max_force_n:g} N allowed: stopped and lifted"
            )

    return check


class GuardedStage:
    """Moves in the pad's frame. `force_of` is the reference's newest force; every one of `guards` watches every move.

    `fresh_force_of` waits for a force that was measured after it was asked for: an approach goes no faster than that,
    whatever the reference's rate.
    """

    def __init__(
        self, stage: Stage, origin: Place, limits: Limits, force_of: ForceOf, guards: Sequence[Guard] = (), *,
        fresh_force_of: ForceOf | None = None,
    ) -> None:  # fmt: skip
        if not (limits.bottom_m < 0 < limits.top_m and limits.deepest_m > 0 and limits.max_force_n > CONTACT_N):
            raise InputError(f"limits {limits} leave no way to the pad and back: bottom < 0 < top, deepest > 0")
        self.stage, self.limits = stage, limits
        self._origin, self._fresh_force_of = origin, fresh_force_of or force_of
        self._guards = [force_guard("the reference", force_of, limits.max_force_n), *guards]
        self.surface, self._is_tip_known = ContactSurface(), True
        self._aside = Place(0.0, 0.0, 0.0)
        self.free_until_s = 0.0  # host_clock.now() until which nothing touched, in the last approach
        self.way_down: list[tuple[float, float]] = []  # its last stops: height, m, and force, N

    def change_tip(self, aside: Place) -> None:
        """Another tip is mounted, or the pad turned, whose middle then lies `aside` of where it was at first.

        The next approach is slow all the way down, and heights count from where it touches.
        """
        self._origin, self._aside = self._origin.minus(self._aside).plus(aside), aside
        self.surface, self._is_tip_known = ContactSurface(), False

    def place(self) -> Place:
        """Position of the tip."""
        return self.stage.position().minus(self._origin)

    def lift(self) -> None:
        """Retract straight up, whatever the forces."""
        here = self.place()
        self.stage.move(Place(here.x_m, here.y_m, self.limits.top_m).plus(self._origin), APPROACH_M_S)

    def go_above(self, x_m: float, y_m: float) -> None:
        """Lift, then over a place of the pad."""
        self.limits.check(Place(x_m, y_m, self.limits.top_m))
        self.lift()
        self._move(Place(x_m, y_m, self.limits.top_m), TRAVEL_M_S)

    def turn(self, degrees: Mapping[str, float]) -> None:
        """Turn what is pressed; the guards watch."""
        self.stage.turn(degrees, self._watch)

    def approach(self, x_m: float, y_m: float) -> float:
        """Down until it touches; height of the contact.

        Raises
        ------
        RefusedError
            It touches before it moves, nothing is there, or the pad is not where the contacts before say: lost steps.
        """
        self.go_above(x_m, y_m)
        rest_n = self._force_n()
        if rest_n > CONTACT_N:
            raise RefusedError(f"something presses with {rest_n:.2f} N above the pad at {self.place()}: "
                               "tare the reference, and look what hangs on it")  # fmt: skip
        known_m = self.surface.expected(x_m, y_m)
        near_m = self.limits.near_m if known_m is None else known_m + NEAR_M + APPROACH_STEP_M
        z_m = min(self.limits.top_m, near_m) if self._is_tip_known else self.limits.top_m
        if z_m < self.limits.top_m:
            self._move(Place(x_m, y_m, z_m), APPROACH_M_S)
        steps, felt = [host_clock.now()], [(z_m, self._force_n())]
        while felt[-1][1] < CONTACT_N:
            steps.append(host_clock.now())
            z_m -= APPROACH_STEP_M
            if z_m < self.limits.bottom_m:
                raise RefusedError(
                    f"no contact at {self.place()}: is the pad below the tip, and the reference connected to it?"
                )
            self._move(Place(x_m, y_m, z_m), APPROACH_M_S)
            felt.append((z_m, self._force_n()))
        self.way_down = felt[-FREE_STEPS:]
        self.free_until_s = steps[-min(len(steps), FREE_STEPS)]
        if not self._is_tip_known:
            self._origin, z_m, self._is_tip_known = self._origin.plus(Place(0.0, 0.0, z_m)), 0.0, True
        self.surface.check(x_m, y_m, z_m, LOST_STEPS_M + APPROACH_STEP_M)
        return z_m

    def press(self, x_m: float, y_m: float, contact_z_m: float, depth_m: float) -> Iterator[float]:
        """From a contact deeper, in steps of 0.1 to 0.2 mm; yields the depth at which it stands."""
        if not 0 < depth_m <= self.limits.deepest_m:
            raise RefusedError(f"a depth of {1e3 * depth_m:g} mm is not within 0 to {1e3 * self.limits.deepest_m:g} mm")
        n = max(1, min(round(depth_m / STEP_M), MOST_STEPS), int(np.ceil(depth_m / APPROACH_STEP_M - 1e-9)))
        for step in range(1, n + 1):
            depth = depth_m * step / n
            self._move(Place(x_m, y_m, contact_z_m - depth), PRESS_M_S)
            yield depth

    def slide_to(self, place: Place) -> Iterator[Place]:
        """Sideways in contact, in steps of 0.1 mm; yields where it stands."""
        start = self.place()
        n = max(1, int(np.ceil(start.distance(place) / STEP_M - 1e-9)))
        for step in range(1, n + 1):
            here = Place(*(a + (b - a) * step / n for a, b in zip(start, place, strict=True)))
            self._move(here, PRESS_M_S)
            yield here

    @contextlib.contextmanager
    def safely(self) -> Iterator[None]:
        """A context in which any exception, also Ctrl-C, lifts the tip before it is reported."""
        try:
            yield
        except BaseException as error:
            try:
                self._retreat()
            except RuffiniError as second:
                told = f"THE TIP WAS NOT LIFTED: {second}"
                if not isinstance(error, RuffiniError):  # Ctrl-C says nothing by itself
                    raise NoDeviceError(told) from error
                error.add_note(told)
            raise

    def _retreat(self) -> None:
        """Lift; a machine that does not know any more where it is goes up as far as it takes at most."""
        try:
            self.lift()
        except RuffiniError:
            self.stage.raise_by(self.limits.top_m - self.limits.bottom_m, APPROACH_M_S)

    def _force_n(self) -> float:
        """Size of the force, whatever its direction: a reference that stands askew must stop the tip too."""
        return float(np.linalg.norm(np.nan_to_num(self._fresh_force_of()[:3])))

    def _move(self, place: Place, speed_m_s: float) -> None:
        self.limits.check(place)
        for guard in self._guards:
            guard()
        self.stage.move(place.plus(self._origin), speed_m_s, self._watch)

    def _watch(self) -> None:
        for guard in self._guards:
            guard()


class DryStage:
    """A stage for dry runs that reaches every position at once and records its moves."""

    name = "dry run"

    def __init__(self, start: Place) -> None:
        self._place = start
        self.moves: list[Place] = []
        self.turned: dict[str, float] = {}
        self.duration_s = 0.0

    def home(self) -> None:
        self.moves.clear()

    def position(self) -> Place:
        return self._place

    def move(self, place: Place, speed_m_s: float, guard: Guard = lambda: None) -> None:
        guard()
        self.duration_s += self._place.distance(place) / speed_m_s
        self._place = place
        self.moves.append(place)

    def turn(self, degrees: Mapping[str, float], guard: Guard = no_guard) -> None:
        self.turned = dict(degrees)

    def halt(self) -> None:
        self.moves.append(self._place)

    def raise_by(self, height_m: float, speed_m_s: float) -> None:
        self.move(self._place.plus(Place(0.0, 0.0, height_m)), speed_m_s)

    def close(self) -> None:
        self.moves.append(self._place)
