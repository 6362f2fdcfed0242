"""What a live twin plays: a program and scripted faults, in a file or by name. Strict.

schema = 1
program = "demo"             # or grid, rest, connector, or a way of [touch]: press shear twist roll slide ...
n = 10                       # presses (grid), frames (rest), or frames of each load (connector)
seed = 1
strain = "finite"            # of a flat pad, is_relaxing likewise; as twin.toml says where left out
[touch]
indenter = "square"          # any of `ruffini.sim.indenters`
radius_um = 5000
shore_a = 40                 # rigid without
[[fault]]
kind = "led_off"             # stall drop over_exposure led_off lens_cap torn_gel light_leak
first_frame = 100
n_frames = 20
leds = [2]
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field, ValidationError, model_validator

from ruffini.boards import Board, Section
from ruffini.errors import InputError
from ruffini.files import readable
from ruffini.older_python import tomllib
from ruffini.sim.bodies import touches
from ruffini.sim.bodies.connector import connector
from ruffini.sim.optics.conditions import Conditions, TrayPose
from ruffini.sim.optics.renderer import Renderer
from ruffini.sim.programs import Rest, Step
from ruffini.sim.settings import Strain, TwinSettings, load_twin
from ruffini.sim.trajectories import TRAJECTORIES, TouchSettings, TrajectoryName, told

Array = npt.NDArray[np.float64]
Frame = Annotated[int, Field(ge=0, le=10_000_000)]
Um = Annotated[int, Field(ge=-500_000, le=500_000)]


class _Fault(Section):
    first_frame: Frame
    n_frames: Annotated[int, Field(ge=1, le=10_000_000)]

    def covers(self, frame: int) -> bool:
        return self.first_frame <= frame < self.first_frame + self.n_frames

    def applied(self, conditions: Conditions) -> Conditions:
        """The optics with this fault on top; the faults of the line leave them as they are."""
        return conditions


class Stall(_Fault):
    """No frame comes."""

    kind: Literal["stall"]


class Drop(_Fault):
    """Single frames do not come."""

    kind: Literal["drop"]
    share_1e3: Annotated[int, Field(ge=1, le=1000)]


class OverExposure(_Fault):
    """All light is multiplied."""

    kind: Literal["over_exposure"]
    factor_1e3: Annotated[int, Field(ge=1000, le=100_000)]

    def applied(self, conditions: Conditions) -> Conditions:
        return dataclasses.replace(conditions, exposure=conditions.exposure * self.factor_1e3 * 1e-3)


class LedOff(_Fault):
    """Lamps go dark."""

    kind: Literal["led_off"]
    leds: Annotated[list[Annotated[int, Field(ge=0, le=63)]], Field(min_length=1)]

    def applied(self, conditions: Conditions) -> Conditions:
        return dataclasses.replace(conditions, lamps_off=(*conditions.lamps_off, *self.leds))


class LensCap(_Fault):
    """No light gets in."""

    kind: Literal["lens_cap"]

    def applied(self, conditions: Conditions) -> Conditions:
        return dataclasses.replace(conditions, is_capped=True)


class TornGel(_Fault):
    """A round hole in the coating; x and y from the pad's centre."""

    kind: Literal["torn_gel"]
    x_um: Um
    y_um: Um
    radius_um: Annotated[int, Field(ge=1, le=500_000)]

    def applied(self, conditions: Conditions) -> Conditions:
        return dataclasses.replace(conditions, tear_um=(self.x_um, self.y_um, self.radius_um))


class LightLeak(_Fault):
    """Daylight from the left edge, over the mean level."""

    kind: Literal["light_leak"]
    level_1e3: Annotated[int, Field(ge=1, le=10_000)]

    def applied(self, conditions: Conditions) -> Conditions:
        return dataclasses.replace(conditions, leak=conditions.leak + self.level_1e3 * 1e-3)


Fault = Annotated[
    Stall | Drop | OverExposure | LedOff | LensCap | TornGel | LightLeak, Field(discriminator="kind")
]  # fmt: skip
FAULT_KINDS = ("stall", "drop", "over_exposure", "led_off", "lens_cap", "torn_gel", "light_leak")


class Scenario(Section):
    """A program and its faults."""

    schema_version: Annotated[Literal[1], Field(alias="schema")] = 1
    program: Literal["demo", "grid", "rest", "connector"] | TrajectoryName = "demo"
    n: Annotated[int, Field(ge=1, le=1_000_000)] = 40
    seed: Annotated[int, Field(ge=0, le=2**31)] = 1
    strain: Strain | None = None
    is_relaxing: bool | None = None
    touch: TouchSettings | None = None
    fault: list[Fault] = Field(default=[])

    @model_validator(mode="after")
    def _touch_has_a_way(self) -> Scenario:
        if self.touch is not None and self.program not in TRAJECTORIES:
            raise ValueError(
                f"[touch] goes one of the ways {', '.join(TRAJECTORIES)}: program {self.program!r} is none"
            )
        return self

    def twin(self, board: Board) -> TwinSettings:
        """The board's twin with this scenario's pad.

        Raises
        ------
        InputError
            The board has no twin, or its gel does not relax.
        """
        return load_twin(board).with_pad(strain=self.strain, is_relaxing=self.is_relaxing)

    def story(self, board: Board) -> list[Step]:
        """The program's steps on a board."""
        if self.program == "demo":
            return touches.demo(board, load_twin(board))
        if self.program == "grid":
            return touches.grid(board, load_twin(board), self.n, np.random.default_rng(self.seed))
        if self.program == "rest":
            return [Rest(self.n)]
        n_rest = board.pipeline.n_rest_frames + 2
        if self.program == "connector":
            return connector(n_rest, self.n, np.random.default_rng(self.seed))
        return told(self.program, self.touch or TouchSettings(), n_rest, np.random.default_rng(self.seed))

    def conditions(self, frame: int) -> Conditions:
        """Optics of a frame."""
        now = Conditions()
        for fault in self.fault:
            if fault.covers(frame):
                now = fault.applied(now)
        return now

    def is_sent(self, frame: int, *, is_unlit: bool = False) -> bool:
        """Whether the frame reaches the camera's line at all; by the seed, whenever it is asked.

        is_unlit : the one without lamps before it, of a board that alternates.
        """
        for i, fault in enumerate(self.fault):
            if not fault.covers(frame):
                continue
            if fault.kind == "stall":
                return False
            if fault.kind == "drop":
                lot = np.random.default_rng([self.seed, i, frame, *([1] if is_unlit else [])]).integers(1000)
                if lot < fault.share_1e3:
                    return False
        return True

    def picture(
        self,
        renderer: Renderer,
        frame: int,
        displacement_m: Array,
        previous_m: Array | None,
        tray: TrayPose | None = None,
        *,
        is_unlit: bool = False,
    ) -> npt.NDArray[np.uint8]:
        """Frame `frame`, (h, w, 3) uint8 B G R, of displacements (n, 3) now and one frame before, metres.

        Recordings and the live twin make theirs here, so they are equal bit for bit.
        is_unlit : with the lamps off, as `is_sent` has it.
        """
        conditions = self.conditions(frame)
        return renderer.image(
            displacement_m,
            np.random.default_rng([self.seed, frame, *([1] if is_unlit else [])]),
            previous_m=previous_m,
            time_s=frame * 1e3 / renderer.board.camera.rate_mhz,
            conditions=dataclasses.replace(conditions, is_unlit=is_unlit),
            tray=tray,
        )

    def computed_from(
        self,
        renderer: Renderer,
        frame: int,
        displacement_m: Array,
        previous_m: Array | None,
        tray: TrayPose | None = None,
    ) -> npt.NDArray[np.uint8]:
        """What the frame path gets of a frame: `picture`, of a board that alternates less what is there unlit.

        As firmware/base/ambient.h: not below 0, and what is full stays full.
        """
        lit = self.picture(renderer, frame, displacement_m, previous_m, tray)
        if not renderer.board.alternates:
            return lit
        dark = self.picture(renderer, frame, displacement_m, previous_m, tray, is_unlit=True)
        return np.where(lit == 255, lit, lit - np.minimum(lit, dark)).astype(np.uint8)


def scenario_of(tree: dict[str, Any], where: str) -> Scenario:
    """A scenario of keys and values; `where` names their source in messages.

    Raises
    ------
    InputError
        A key or a value is not as it should be.
    """
    try:
        return Scenario.model_validate(tree)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"] if part not in FAULT_KINDS)
        kind = {"extra_forbidden": "unknown key, check the spelling or remove it",
                "missing": "key is missing"}.get(first["type"], first["msg"])  # fmt: skip
        raise InputError(f"{where}: {key}: {kind}") from error


def load_scenario(path: Path) -> Scenario:
    """A scenario file.

    Raises
    ------
    InputError
        It cannot be read or is not as it should be.
    """
    try:
        return scenario_of(tomllib.loads(readable(path).read_bytes().decode("utf-8")), str(path))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}): check --scenario") from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{path}: not TOML: {error}") from error
