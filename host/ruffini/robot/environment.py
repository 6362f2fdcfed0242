"""Gymnasium: `ruffini/AdaptiveGrip-v0`, after `import ruffini.robot.environment`."""

from __future__ import annotations

from typing import Any, ClassVar

import gymnasium
import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.errors import InputError
from ruffini.robot.core_sensor import NOISE_M
from ruffini.robot.gripper import Gripper, Thing

NAME = "ruffini/AdaptiveGrip-v0"
MOST_N, LEAST_N = 12.0, 0.3  # of the grip
SPEED_M_S = 0.04  # of the lift
CLOSE_FRAMES, FRAMES = 40, 180
DROPPED_M = 0.01
FULL_N, FULL_NM = 20.0, 0.5  # bounds of the observations

Observation = dict[str, npt.NDArray[np.float32]]


class AdaptiveGrip(gymnasium.Env[Observation, npt.NDArray[np.float32]]):
    """Lift a can of unknown weight and friction, with little force. One step is one frame of the pads (SIMULATED).

    Parameters
    ----------
    board : of both pads.

    Notes
    -----
    Action (1,): grip of each finger, N.

    Observation: arrays of each pad, left then right, as the core reports them, 0 where it reports none:
    `wrench` (2, 6) N and N m ON the pad about its undeformed centre; `slip` (2, 4): 0 no state, 1 sticks, 2 incipient,
    3 slides; share of the contact that slips; friction coefficient; shear that it still takes, N. `grip` (1,) N.

    Reward: 1 - grip / 12 N for each step in which the can is held; 0 after it is dropped, which ends the episode.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": []}

    def __init__(self, board: str | Board, **options: Any) -> None:
        self._board, self._options = board, options
        self.action_space = gymnasium.spaces.Box(LEAST_N, MOST_N, (1,), np.float32)
        top = np.array([[FULL_N] * 3 + [FULL_NM] * 3] * 2, np.float32)
        most = np.array([[3, 1, 10, FULL_N]] * 2, np.float32)
        self.observation_space = gymnasium.spaces.Dict(
            {
                "wrench": gymnasium.spaces.Box(-top, top),
                "slip": gymnasium.spaces.Box(np.array([[0, 0, 0, -FULL_N]] * 2, np.float32), most),
                "grip": gymnasium.spaces.Box(0, MOST_N, (1,), np.float32),
            }
        )
        self._gripper: Gripper | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Another can; the gripper closes on it with the least force."""
        super().reset(seed=seed)
        self.close()
        thing = Thing(
            mass_kg=float(self.np_random.uniform(0.06, 0.3)), friction=float(self.np_random.uniform(0.4, 0.9))
        )
        number = int(self.np_random.integers(2**31))
        self._gripper = Gripper(self._board, thing, noise_m=NOISE_M, seed=number, **self._options)
        self._gripper.grip_n, self._n = 2 * LEAST_N, 0
        for _ in range(CLOSE_FRAMES):
            frames = self._gripper.step()
        return self._seen(frames), {"mass_kg": thing.mass_kg, "friction": thing.friction}

    def step(
        self, action: npt.NDArray[np.float32]
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:  # fmt: skip
        """One frame with this grip."""
        grip_n = np.asarray(action, np.float64)
        if grip_n.shape != (1,) or not np.isfinite(grip_n).all():
            raise InputError(f"action {action}: give one finite number in an array of shape (1,), the grip in newtons")
        if self._gripper is None:
            raise InputError("the environment holds nothing yet: call reset() before step()")
        self._n += 1
        self._gripper.grip_n = float(np.clip(grip_n[0], LEAST_N, MOST_N))
        self._gripper.lift_m = min(self._n * SPEED_M_S * self._gripper.frame_s, 0.05)
        frames = self._gripper.step()
        slipped_m = self._gripper.slipped_m
        is_dropped = slipped_m > DROPPED_M
        reward = 0.0 if is_dropped else 1 - self._gripper.grip_n / MOST_N
        return self._seen(frames), reward, is_dropped, self._n >= FRAMES, {"slipped_m": slipped_m}

    def close(self) -> None:
        """Free the cores."""
        if self._gripper is not None:
            self._gripper.world.close()
            self._gripper = None

    def _seen(self, frames: dict[str, Any]) -> Observation:
        assert self._gripper is not None
        wrench = np.array([np.nan_to_num(np.concatenate([f.wrench.force, f.wrench.torque])) for f in frames.values()])
        slip = np.zeros((2, 4))
        for row, frame in zip(slip, frames.values(), strict=True):
            for contact in frame.contacts.contacts[:1]:
                states = {None: 0, "sticks": 1, "incipient": 2, "slides": 3}
                row[:] = (
                    states[contact.slip_state], contact.slip_share or 0, contact.friction or 0,
                    contact.slip_margin_n or 0,
                )  # fmt: skip
        spaces = self.observation_space
        assert isinstance(spaces, gymnasium.spaces.Dict)
        seen = {"wrench": wrench, "slip": slip, "grip": np.array([self._gripper.grip_n])}
        bounded: Observation = {}
        for name, value in seen.items():
            box = spaces[name]
            assert isinstance(box, gymnasium.spaces.Box)
            bounded[name] = np.clip(value, box.low, box.high).astype(np.float32)
        return bounded


gymnasium.register(NAME, entry_point=AdaptiveGrip)
