"""What averaging the field of an unchanging contact gains and costs (firmware/solve/steady_field.h). SIMULATED.

The board as it is and with `[contact] steady_frames`, on the same noise: contacts that are held, whose force steps,
that slide and that roll. Judged is the averaged frame against the same frame without averaging, and against the truth.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.bench.coverage import Coverage, Stated
from ruffini.bench.disturbance import WHITE_UM, Disturbance
from ruffini.bench.resolution import no_flat_field
from ruffini.bench.states import JUDGED, State, make_states, on_board
from ruffini.boards import Board, parse_board
from ruffini.calibrate import container
from ruffini.core.pipeline import DISPLACEMENT_LSB_M, Pipeline
from ruffini.errors import InputError
from ruffini.estimators.operator.error_model import N_TOUCHES, node_places
from ruffini.estimators.operator.fit import board_slab, make_operator
from ruffini.fem.operators import Noise
from ruffini.sim.contact import ContactSolver, Indenter, Pose
from ruffini.sim.settings import load_twin
from ruffini.sim.unit import TwinUnit
from ruffini.tables import aligned
from ruffini.wire.covariance import full_covariance

Array = npt.NDArray[np.float64]
Progress = Callable[[float], None]

MM = 1e-3
FRAMES = 8
SETTLED, HELD_FRAMES = 8, 24  # frames before those that are judged, and these
STEPS = (0.05, 0.1, 0.3, 1.0)  # of the held force
SEED = 20_261_127
NAMES = ("each frame", "averaged")


@dataclass(frozen=True)
class Motion:
    """A ball or flat, mm, pressed by `depth` and then moved along x by `speed` a frame; rolling or sliding."""

    name: str
    shape: str
    radius: float
    depth: float
    friction: float
    speed: float
    n_frames: int = 60
    rolls: bool = False

    def poses(self) -> Iterator[Pose]:
        for i in range(8):
            yield Pose(-0.8 * MM, 0.4 * MM, self.depth * (i + 1) / 8 * MM)
        for i in range(self.n_frames):
            way = i * self.speed * MM
            pitch = way / (self.radius * MM) if self.rolls else 0.0
            yield Pose(-0.8 * MM + way, 0.4 * MM, self.depth * MM, pitch_rad=pitch)


MOTIONS = (
    Motion("ball sheared until it slides", "sphere", 6.5, 0.55, 0.5, 0.02),
    Motion("flat sheared until it slides", "flat", 2.2, 0.35, 0.55, 0.02),
    Motion("ball, a fifth as fast", "sphere", 6.5, 0.55, 0.5, 0.004, 100),
    Motion("ball rolling", "sphere", 6.0, 0.6, 0.8, 0.02),
)


def averaging(board: Board, frames: int = FRAMES) -> Board:
    """The board with that many `steady_frames`."""
    text = re.sub(r"(?m)^steady_frames.*\n", "", board.text)
    text = re.sub(r"(?m)^(min_nodes\s*=.*)$", rf"\1\nsteady_frames = {frames}", text)
    return parse_board(text, f"{board.name}, {frames} steady frames")


class Pair:
    """The board without and with averaging; both see the same noise."""

    def __init__(self, board: Board, data: bytes, rng: np.random.Generator) -> None:
        self._pipelines = {
            name: Pipeline(each, data)
            for name, each in zip(NAMES, (averaging(board, 1), averaging(board)), strict=True)
        }
        self._lsb_n, self._rng = board.field.force_lsb_un * 1e-6, rng
        self._noise = Disturbance(white_um=WHITE_UM)

    def close(self) -> None:
        for pipeline in self._pipelines.values():
            pipeline.close()

    def rest(self, shape: tuple[int, ...]) -> None:
        """An untouched frame: what was averaged is forgotten."""
        for pipeline in self._pipelines.values():
            pipeline.solve(np.zeros((1, shape[0] * shape[1], 3), np.int16))

    def see(self, displacement: Array) -> dict[str, Stated]:
        noisy = (displacement + self._noise.draw(displacement.shape, self._rng)) / DISPLACEMENT_LSB_M
        u = np.clip(np.round(noisy), -32767, 32767).astype(np.int16).reshape(1, -1, 3)
        out = {}
        for name, pipeline in self._pipelines.items():
            force = np.asarray(pipeline.solve(u).reshape(displacement.shape) * self._lsb_n, np.float64)
            sigma, upper = pipeline.sigma()
            stated = np.asarray(sigma.reshape(force.shape) * self._lsb_n, np.float64)
            out[name] = Stated(force, stated, full_covariance(upper))
        return out


@dataclass
class HeldScores:
    """Of one way, over held contacts: noise (N) over time, errors, false shear."""

    coverage: Coverage
    shear_n: list[float] = field(default_factory=list)
    normal_n: list[float] = field(default_factory=list)
    tangential: list[float] = field(default_factory=list)
    normal: list[float] = field(default_factory=list)
    false_shear: list[float] = field(default_factory=list)

    def add(self, state: State, frames: list[Stated]) -> None:
        force, true = np.array([f.force for f in frames]), state.force
        deviation = force.std(axis=0)[(force != 0).any(axis=-1).mean(axis=0) > 0.5]
        self.shear_n.append(_rms(deviation[:, :2]))
        self.normal_n.append(_rms(deviation[:, 2]))
        self.normal += [_relative(f, true, 2) for f in force]
        if state.recipe.is_pure:
            self.false_shear += [float(np.linalg.norm(f[..., :2]) / np.linalg.norm(f[..., 2])) for f in force]
        else:
            self.tangential += [_relative(f, true, slice(0, 2)) for f in force]
        for stated in frames:
            self.coverage.add(stated, true)

    def means(self) -> dict[str, float]:
        columns = self.coverage.summary()
        within = {f"{c}_{k}": columns[c + " inside"][f"within_{k}"] for c in ("shear", "normal") for k in (1, 2)}
        lists = {name: values for name, values in vars(self).items() if isinstance(values, list)}
        return {name: float(np.mean(values)) for name, values in lists.items()} | within


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _relative(force: Array, true: Array, axes: slice | int) -> float:
    """Relative L2 error of the components; of next to none against 5 % of the whole force."""
    size = max(float(np.linalg.norm(true[..., axes])), 0.05 * float(np.linalg.norm(true)))
    return float(np.linalg.norm((force - true)[..., axes])) / size


def run(board: Board, *, quick: bool = False, progress: Progress = lambda _: None) -> dict[str, Any]:
    """Everything in plain numbers.

    Raises
    ------
    InputError
        The board computes no field of forces of a flat pad, or has no twin.
    """
    if refused := no_flat_field(board):
        raise InputError(refused)
    kind = make_operator(
        board,
        method="support",
        noise=Noise((5e-6, 5e-6, 20e-6)),
        n_touches=N_TOUCHES // 4 if quick else N_TOUCHES,
        is_fitted=True,
    )
    data = container.pack(kind.tensors, {**container.base_metadata(board), **kind.metadata}).data
    progress(0.3)
    depths = (0.6,) if quick else (0.3, 0.6)
    # Twice as deep gives the shape of a step: on a linear pad any sum of contacts is one.
    states = make_states(board, JUDGED, (*depths, *(1.5 * d for d in depths)))
    progress(0.5)
    unit = TwinUnit.build(board, twin=load_twin(board).with_pad(strain="linear", is_relaxing=False))
    result: dict[str, Any] = {
        "board": board.name, "simulated": True, "quick": quick, "frames": FRAMES, "noise_um": WHITE_UM,
    }  # fmt: skip
    pair = Pair(board, data, np.random.default_rng(SEED))
    try:
        at_depth = [(s, _deeper(s, states)) for s in states if s.depth_mm in depths]
        result["held"] = _held(board, pair, [s for s, _ in at_depth])
        progress(0.7)
        result["steps"] = {f"{100 * step:.0f} %": _steps(pair, at_depth, step) for step in STEPS}
        progress(0.8)
        motions = MOTIONS[1:2] if quick else MOTIONS
        result["moving"] = {m.name: _moving(unit, pair, m) for m in motions}
    finally:
        pair.close()
    progress(1.0)
    return result


def _deeper(state: State, states: list[State]) -> State:
    return next(s for s in states if s.recipe == state.recipe and s.depth_mm == 1.5 * state.depth_mm)


def _held(board: Board, pair: Pair, states: list[State]) -> dict[str, dict[str, float]]:
    places, lsb_n = node_places(board_slab(board), board.observed), board.field.force_lsb_un * 1e-6
    threshold_n = board.contact.threshold_un * 1e-6
    scores = {name: HeldScores(Coverage(places, lsb_n, threshold_n)) for name in NAMES}
    for state in states:
        pair.rest(state.force.shape)
        seen = [pair.see(state.displacement) for _ in range(SETTLED + HELD_FRAMES)][SETTLED:]
        for name, s in scores.items():
            s.add(state, [frame[name] for frame in seen])
    return {name: s.means() for name, s in scores.items()}


def _steps(pair: Pair, states: list[tuple[State, State]], step: float) -> dict[str, float]:
    """Of contacts whose force grows by this share from one frame to the next, as it grows when pressed deeper.

    `seen`: part of the true step of force along itself that the first frame shows; `lost_un`: of the total force of
    that frame, the largest difference between averaged and not; `error_ratio`: of nodal errors, averaged over not,
    mean and worst.
    """
    seen: dict[str, list[float]] = {name: [] for name in NAMES}
    lost: list[float] = []
    ratio: list[float] = []
    for state, deeper in states:
        size = step * state.resultant_n / float(np.linalg.norm((deeper.force - state.force).sum(axis=(0, 1))))
        force = state.force + size * (deeper.force - state.force)
        displacement = state.displacement + size * (deeper.displacement - state.displacement)
        pair.rest(force.shape)
        held = [pair.see(state.displacement) for _ in range(SETTLED + 4)]
        first = pair.see(displacement)
        true = (force - state.force).sum(axis=(0, 1))
        for name in NAMES:
            before = np.mean([h[name].force.sum(axis=(0, 1)) for h in held], axis=0)
            seen[name].append(float((first[name].force.sum(axis=(0, 1)) - before) @ true / (true @ true)))
        each, averaged = (first[name].force for name in NAMES)
        lost.append(1e6 * float(np.abs((averaged - each).sum(axis=(0, 1))).max()))
        ratio.append(float(np.linalg.norm(averaged - force) / np.linalg.norm(each - force)))
    return {
        "seen": float(np.mean(seen[NAMES[1]])), "seen_each": float(np.mean(seen[NAMES[0]])),
        "lost_un": max(lost), "error_ratio": float(np.mean(ratio)), "worst_ratio": max(ratio),
    }  # fmt: skip


def _moving(unit: TwinUnit, pair: Pair, motion: Motion) -> dict[str, Any]:
    """Mean errors of both, and the worst frame's nodal error of the averaged over that of the other."""
    solver = ContactSolver(unit.model, unit.response(), Indenter(motion.shape, motion.radius * MM), motion.friction)
    errors: dict[str, list[tuple[float, float, float]]] = {name: [] for name in NAMES}
    for i, pose in enumerate(motion.poses()):
        solver.advance(pose)
        now = on_board(unit, solver.hat_force, solver.displacement)
        if i == 0:
            pair.rest(now["force"].shape)
        for name, stated in pair.see(now["displacement"]).items():
            true = now["force"]
            errors[name].append((
                _relative(stated.force, true, slice(0, 2)), _relative(stated.force, true, 2),
                float(np.linalg.norm(stated.force - true)),
            ))  # fmt: skip
    each, averaged = (np.array(errors[name])[8:] for name in NAMES)
    return {
        **{name: {"tangential": float(e[:, 0].mean()), "normal": float(e[:, 1].mean())}
           for name, e in zip(NAMES, (each, averaged), strict=True)},
        "worst_ratio": float((averaged[:, 2] / each[:, 2]).max()),
    }  # fmt: skip


def table(result: dict[str, Any]) -> str:
    """The result as text."""
    noise = "/".join(f"{v:g}" for v in result["noise_um"])
    lines = [
        f"{result['board']}, SIMULATED, noise {noise} um: of single frames, and of means of up to "
        f"{result['frames']} steady frames",
        "held contacts: noise of a node over time, errors of the field, shares within one and two stated sigmas",
    ]
    head = ("", "noise shear", "noise normal", "false shear", "tangential", "normal", "shear within", "normal within")
    lines += aligned(head, [
        (
            name, f"{1e3 * s['shear_n']:.3f} mN", f"{1e3 * s['normal_n']:.2f} mN", f"{s['false_shear']:.4f}",
            f"{s['tangential']:.3f}", f"{s['normal']:.3f}", f"{s['shear_1']:.0f}, {s['shear_2']:.0f} %",
            f"{s['normal_1']:.0f}, {s['normal_2']:.0f} %",
        )
        for name, s in result["held"].items()
    ], "  ")  # fmt: skip
    lines += ["", "the frame in which the force grows"]
    lines += aligned(("by", "step seen, each", "averaged", "force lost", "nodal error over each", "worst"), [
        (
            step, f"{100 * s['seen_each']:.0f} %", f"{100 * s['seen']:.0f} %", f"{s['lost_un']:.0f} uN",
            f"{s['error_ratio']:.2f}", f"{s['worst_ratio']:.2f}",
        )
        for step, s in result["steps"].items()
    ], "  ")  # fmt: skip
    each, averaged = NAMES
    lines += ["", "moving contacts: tangential and normal error, and the worst frame's nodal error over each frame's"]
    lines += aligned(("", "each", "averaged", "worst"), [
        (
            name, f"{m[each]['tangential']:.3f}, {m[each]['normal']:.3f}",
            f"{m[averaged]['tangential']:.3f}, {m[averaged]['normal']:.3f}", f"{m['worst_ratio']:.2f}",
        )
        for name, m in result["moving"].items()
    ], "  ")  # fmt: skip
    return "\n".join(lines)
