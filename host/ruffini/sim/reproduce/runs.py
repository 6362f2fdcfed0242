"""The runs of a reproduce.toml: each is one approach of one indenter or one load by hand, with its own seed."""

from __future__ import annotations

import hashlib
import itertools
from dataclasses import dataclass

import numpy as np

from ruffini.boards import Board
from ruffini.sim.bodies.connector import CONDITIONS, hand_load
from ruffini.sim.indenters import Indenter, Material
from ruffini.sim.pose import Pose
from ruffini.sim.programs import Load, Rest, Step, Touch
from ruffini.sim.reproduce.settings import HandSet, Lists, PressSet, ReproduceSettings

UM = 1e-6
QUICK_EVERY, LEAST_QUICK = 8, 3  # of the drawn runs of a set; of small sets more often, so that so many remain
N_REST = 2  # untouched frames after the board's rest frames

AXES = tuple(Lists.model_fields)


@dataclass(frozen=True)
class Run:
    """One run of a set.

    key : its folder below the output; seed : everything random in it follows from it.
    indenter : None of a load by hand.
    chosen : its value on each of the set's lists; condition and take of a load by hand.
    """

    key: str
    seed: int
    settings: PressSet | HandSet
    indenter: Indenter | None
    chosen: dict[str, object]

    @property
    def n_pressed_before(self) -> int:
        return int(str(self.chosen.get("after", 0)))

    def frame_every(self, rate_hz: float) -> int:
        """How many of the camera's frames one of the recording stands for: at a slow speed the others are left out."""
        if "speed_um_s" not in self.chosen or not isinstance(self.settings, PressSet):
            return 1
        return max(1, int(self.settings.step_um * rate_hz / float(str(self.chosen["speed_um_s"])) + 1e-9))

    def poses(self, rate_hz: float) -> list[Pose]:
        """Where the indenter stands, frame by frame."""
        x, y = _pair(self.chosen.get("at_um"))
        dx, dy = _pair(self.chosen.get("shift_um"))
        turn = float(str(self.chosen.get("turn_mrad", 0))) * 1e-3
        roll, pitch = (1e-3 * angle for angle in _pair(self.chosen.get("tilt_mrad")))
        s = self.settings
        assert isinstance(s, PressSet)
        step_um = float(str(self.chosen["speed_um_s"])) / rate_hz if "speed_um_s" in self.chosen else s.step_um
        n = max(1, round(s.depth_um / step_um))
        facing = s.second.turn_mrad * 1e-3 if s.second else 0.0
        down = [Pose(x * UM, y * UM, s.depth_um * UM * (i + 1) / n, facing, roll, pitch) for i in range(n)]
        poses, last = list(down), down[-1]
        if dx or dy or turn:
            end = Pose((x + dx) * UM, (y + dy) * UM, s.depth_um * UM, facing + turn, roll, pitch)
            poses += [last.towards(end, (i + 1) / s.side_steps) for i in range(s.side_steps)]
        poses += [poses[-1]] * s.hold_frames
        if s.returns:
            top = poses[-1]
            free = Pose(top.x_m, top.y_m, 0.0, top.turn_rad, roll, pitch)
            poses += [top.towards(free, (i + 1) / n) for i in range(n)]
        return poses

    def story(self, board: Board) -> list[Step]:
        """Untouched frames, then the touch or load; all of it is judged."""
        rest = Rest(board.pipeline.n_rest_frames + N_REST)
        if isinstance(self.settings, HandSet):
            signs, n = CONDITIONS[int(str(self.chosen["condition"])) - 1], self.settings.frames
            rng = np.random.default_rng([self.seed, 2])
            ways = (signs, -signs) if signs[5] else (signs,)  # the last one is twisted both ways
            largest = self.settings.largest
            return [rest, *(Load(hand_load(way, n, rng, largest), [True] * n) for way in ways)]
        assert self.indenter is not None
        poses = self.poses(board.camera.rate_mhz * 1e-3)
        return [rest, Touch(self.indenter, poses, [True] * len(poses))]


def _pair(value: object) -> tuple[float, float]:
    pair = value if isinstance(value, (list, tuple)) else (0, 0)
    return float(pair[0]), float(pair[1])


def _indenter(s: PressSet, chosen: dict[str, object]) -> Indenter:
    shape, radius_m = str(chosen["indenter"]), float(str(chosen["radius_um"])) * UM
    if s.second is not None:
        other = Indenter(s.second.indenter, s.second.radius_um * UM)
        return Indenter.two(Indenter(shape, radius_m), other, s.second.distance_um * UM, s.second.lift_um * UM)
    if "shore_a" not in chosen:
        return Indenter(shape, radius_m)
    hardness = float(str(chosen["shore_a"]))
    material = Material.of_shore_a(hardness, core_part=s.core_1e3 * 1e-3, skin_part=s.skin_1e3 * 1e-3)
    return Indenter(shape, radius_m, material)


def runs_of(settings: ReproduceSettings, *, quick: bool = False) -> list[Run]:
    """Every run, in the order of the file; with `quick` those of the quick subset, the same seeds and keys.

    Raises
    ------
    InputError
        An indenter cannot be made.
    """
    out = []
    for h in settings.hand:
        n_takes = min(h.quick_takes, h.takes) if quick else h.takes
        for number, (take, condition) in enumerate(itertools.product(range(n_takes), range(len(CONDITIONS)))):
            key = f"{h.name}/{number:04d}"
            out.append(Run(key, _seed(settings, key), h, None, {"take": take + 1, "condition": condition + 1}))
    for s in settings.set_:
        if quick and s.quick is None:
            continue
        for number, chosen in enumerate(_product(s) if s.drawn is None else _drawn(settings, s)):
            key = f"{s.name}/{number:04d}"
            if quick and not _is_quick(s, chosen, number):
                continue
            out.append(Run(key, _seed(settings, key), s, _indenter(s, chosen), chosen))
    return out


def _seed(settings: ReproduceSettings, key: str) -> int:
    return int.from_bytes(hashlib.sha256(f"{settings.seed}/{key}".encode()).digest()[:4], "big") >> 1


def _product(s: PressSet) -> list[dict[str, object]]:
    lists = {name: values for name in AXES if (values := getattr(s, name)) is not None}
    return [dict(zip(lists, chosen, strict=True)) for chosen in itertools.product(*lists.values())]


def _drawn(settings: ReproduceSettings, s: PressSet) -> list[dict[str, object]]:
    lists = {name: values for name in AXES if (values := getattr(s, name)) is not None}
    runs = []
    for number in range(s.drawn or 0):
        rng = np.random.default_rng([_seed(settings, f"{s.name}/{number:04d}"), 6])
        runs.append({name: _drawn_value(rng, values) for name, values in lists.items()})
    return runs


def _drawn_value(rng: np.random.Generator, values: list[object]) -> object:
    if isinstance(values[0], str):
        return values[int(rng.integers(len(values)))]
    numbers = np.array(values)
    return np.round(rng.uniform(numbers.min(axis=0), numbers.max(axis=0))).astype(int).tolist()


def _is_quick(s: PressSet, chosen: dict[str, object], number: int) -> bool:
    assert s.quick is not None
    if s.drawn is not None:
        return number % min(QUICK_EVERY, max(s.drawn // LEAST_QUICK, 1)) == 0
    wanted = {name: values for name in AXES if (values := getattr(s.quick, name)) is not None}
    return all(chosen.get(name) in values for name, values in wanted.items())


def readings_rng(run: Run) -> np.random.Generator:
    """Errors of the bench in this run, apart from the pictures' noise."""
    return np.random.default_rng([run.seed, 1])
