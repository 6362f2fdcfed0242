"""A parallel gripper over a table as MJCF: two mirrored fingers, each with a site "left" or "right" for a pad."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from ruffini.boards import Board
from ruffini.errors import InputError
from ruffini.robot.world import NO_NOISE, World

STEP_S = 8e-4
PAD_HEIGHT_M = 0.03  # of the pads' centres over the table
OPENING_M = 0.004  # of each finger beside the object at the start
FINGER_KG, WRIST_KG = 0.3, 0.5
N_SIZES = {"box": 3, "cylinder": 2, "ellipsoid": 3, "sphere": 1}


@dataclass(frozen=True)
class Thing:
    """What is gripped: a block or egg (half sizes), can (radius, half height) or ball (radius), metres."""

    kind: str = "cylinder"
    size_m: tuple[float, ...] = (0.02, 0.03)
    mass_kg: float = 0.15
    friction: float = 0.6
    modulus_pa: float = math.inf

    def __post_init__(self) -> None:
        if self.kind not in N_SIZES:
            raise InputError(f"a thing cannot be a {self.kind!r}: choose one of {', '.join(N_SIZES)}")
        if len(self.size_m) != N_SIZES[self.kind] or not all(0 < size < math.inf for size in self.size_m):
            raise InputError(f"a {self.kind} has {N_SIZES[self.kind]} sizes above zero, in metres, not {self.size_m}")
        if not 0 < self.mass_kg < math.inf or not 0 <= self.friction < math.inf:
            raise InputError(
                f"a thing of {self.mass_kg} kg with friction {self.friction}: give a mass above zero, "
                "and a friction coefficient that is not below"
            )

    @property
    def half_width_m(self) -> float:
        return self.size_m[0]

    @property
    def half_height_m(self) -> float:
        return self.size_m[-1]


def gripper_mjcf(thing: Thing, step_s: float = STEP_S) -> str:
    """The scene as text: actuators "lift" (metres), "grip" (newtons of each finger)."""
    start = thing.half_width_m + OPENING_M
    height = min(PAD_HEIGHT_M, thing.half_height_m)
    size = " ".join(f"{s:g}" for s in thing.size_m)

    def finger(name: str, side: int) -> str:
        return f"""<body name="{name}_finger" pos="{side * start} 0 0">
        <joint name="{name}" type="slide" axis="{-side} 0 0" damping="15"/>
        <geom type="box" size=".008 .01 .012" pos="{side * 0.012} 0 0" mass="{FINGER_KG}" contype="0" conaffinity="0"/>
        <site name="{name}" zaxis="{-side} 0 0"/></body>"""

    return f"""<mujoco><option timestep="{step_s}" integrator="implicitfast"/><worldbody>
    <geom name="table" type="plane" size="1 1 .1"/>
    <body name="wrist" pos="0 0 {height}"><joint name="lift" type="slide" axis="0 0 1" damping="20"/>
    <geom type="box" size=".05 .01 .01" pos="0 0 .06" mass="{WRIST_KG}" contype="0" conaffinity="0"/>
    {finger("left", -1)}{finger("right", 1)}</body>
    <body name="thing" pos="0 0 {thing.half_height_m}"><freejoint/>
    <geom name="thing" type="{thing.kind}" size="{size}" mass="{thing.mass_kg}"
    friction="{thing.friction} .005 .0001"/></body></worldbody>
    <equality><joint joint1="right" joint2="left" solref="0.004 1"/></equality>
    <actuator><position name="lift" joint="lift" kp="8000" kv="150"/>
    <motor name="left" joint="left"/><motor name="right" joint="right"/></actuator></mujoco>"""


class Gripper:
    """The scene with its pads: `grip_n` and `lift_m` are the commands, `step()` one frame of both pads.

    Examples
    --------
    >>> with Gripper("a-board", Thing(mass_kg=0.2)) as gripper:  # doctest: +SKIP
    ...     gripper.grip_n = 1.5
    ...     frames = gripper.step()
    ...     print(frames["left"].wrench.force)
    """

    def __init__(
        self, board: str | Board, thing: Thing, *, noise_m: tuple[float, float, float] = NO_NOISE, seed: int = 0,
        **options: Any,
    ) -> None:  # fmt: skip
        self.thing = thing
        self.world = World(
            gripper_mjcf(thing), {"left": board, "right": board}, noise_m=noise_m, seed=seed,
            moduli_pa={"thing": thing.modulus_pa}, **options,
        )  # fmt: skip
        self.grip_n = self.lift_m = 0.0
        self._body = self.world.data.body("thing")
        self.world.start()
        self._start_m = float(self._body.xpos[2])

    def __enter__(self) -> Gripper:
        return self

    def __exit__(self, *_: object) -> None:
        self.world.close()

    @property
    def frame_s(self) -> float:
        """From frame to frame."""
        return self.world.frame_s

    @property
    def slipped_m(self) -> float:
        """By how much the thing has not come up with the fingers."""
        lifted = float(self.world.data.joint("lift").qpos[0])
        return lifted - (float(self._body.xpos[2]) - self._start_m)

    @property
    def true_force(self) -> dict[str, Any]:
        """Force ON each pad as the physics has it, (3,) N: what a perfect sensor reads."""
        return {name: pad.wrench[:3].copy() for name, pad in self.world.pads.items()}

    def push(self, force_n: tuple[float, float, float]) -> None:
        """Push the thing at its centre, world axes, until the next push."""
        self._body.xfrc_applied[:3] = force_n

    def step(self) -> dict[str, Any]:
        """One frame of both pads under the commands as they are."""
        data = self.world.data
        data.actuator("lift").ctrl[0] = self.lift_m
        data.actuator("left").ctrl[0] = data.actuator("right").ctrl[0] = self.grip_n
        return self.world.step()
