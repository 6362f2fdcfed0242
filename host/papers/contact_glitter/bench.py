"""Depth, three-axis force and hardness of the glitter paper's method, fitted and judged as its README says.

Depth on the nominal indenter; normal force on planar indenters of hardness 90 (Fig. 5); tangential force and moment on
the sheared ones; hardness on all of the calibration. Depth is judged where the paper does, on the smallest and hardest
triangle pressed again and again. Forces are judged over all frames of all judged runs, against the reference sensor as
in the paper; the zeros of its sideways channels are most of what it calls tangential in a straight press, so the error
against the truth stands beside it. Hardness is given twice: with the bench's force, travel and the indenter's known
area, as the paper's calibration has them, and with nothing but what the sensor itself says, where it fails for the
reason that the paper's eq. (3) gives. What the paper shows without a figure (objects, wear) is judged last.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from papers.contact_glitter.method import (
    LEAST_DEPTH_MM,
    MOST_DEPTH_MM,
    Perceptron,
    area_gain,
    gained,
    hardness_factor,
    line,
    measure,
    optical_flow,
    slope,
)
from papers.recorded import Recorded
from ruffini.boards import Board

Array = npt.NDArray[np.float64]

SHAPES = {"triangle": "triangle", "flat": "circle", "square": "square", "sphere": "hemisphere"}
FORCE_HARDNESS = 90  # Fig. 5a
N_FIRST = 10  # presses that Fig. 7a shows


@dataclass(frozen=True)
class Seen:
    """One run: what the flow gave and what the bench read, frame by frame."""

    recorded: Recorded
    fall: Array
    area_mm2: Array
    tangential: Array
    force: Array  # (t, 6) N and N m, of the reference sensor

    @property
    def shape(self) -> str:
        return str(self.recorded.run.chosen["indenter"])

    @property
    def is_hertzian(self) -> bool:
        return self.shape == "sphere"

    @property
    def hardness(self) -> float:
        return float(self.recorded.rig["shore_a"])

    @property
    def normal_n(self) -> Array:
        return -self.force[:, 2]

    @property
    def travel_mm(self) -> Array:
        """Of the stage since the touch."""
        return self.recorded.rig["depth_m"][self.recorded.touched] * 1e3

    @property
    def true_force(self) -> Array:
        """(t, 6) N and N m, which nothing of the bench reads."""
        return self.recorded.truth["wrench"][self.recorded.touched]

    @property
    def known_area_mm2(self) -> float:
        """Of a planar indenter's face."""
        half = float(str(self.recorded.run.chosen["radius_um"])) * 1e-3
        return {"triangle": float(np.sqrt(3)), "square": 4.0, "flat": float(np.pi)}[self.shape] * half**2

    @property
    def gel_depth_mm(self) -> Array:
        """The gel's own depth as the bench has it: with the error of the stage's zero."""
        frames = self.recorded.touched
        zero = self.recorded.rig["depth_m"][frames] - self.recorded.truth["pose"][frames, 2]
        return np.asarray(self.recorded.rig["gel_depth_m"][frames] + zero) * 1e3


def see(board: Board, recorded: Recorded) -> Seen:
    """Flow of every touched frame of a run."""
    px_per_mm = board.camera.focal_mpx / board.camera.standoff_um
    untouched = np.asarray(np.rint(recorded.rest()), dtype=np.uint8)
    flow, rows = None, []
    for frame in recorded.touched:
        flow = optical_flow(untouched, recorded.picture(int(frame)), flow)
        seen = measure(flow, px_per_mm)
        rows.append((seen.fall, seen.area_mm2, seen.tangential))
    fall, area, tangential = np.array(rows).T
    return Seen(recorded, fall, area, tangential, recorded.rig["force"][recorded.touched])


def judge(board: Board, runs: list[Recorded]) -> dict[str, float]:
    """RMSE of every figure over all frames of the judged runs."""
    sets: dict[str, list[Seen]] = {}
    for recorded in runs:
        sets.setdefault(recorded.set_name, []).append(see(board, recorded))
    method = Method.fit(sets["nominal"], sets["calibration"], sets["shear"])
    figures = _forces(method, sets["test"], sets["test_shear"])
    figures["depth"] = _rmse([method.depth(s) - s.gel_depth_mm for s in sets["repeat"]])
    figures["depth, all shapes and sizes"] = _rmse([method.depth(s) - s.gel_depth_mm for s in sets["test"]])
    figures["hardness"] = _rmse([method.bench(method.told(s)) - s.hardness for s in sets["test"]])
    figures["hardness, from the sensor alone"] = _rmse([method.alone(method.own(s)) - s.hardness for s in sets["test"]])
    return figures | _shown(method, sets)


def _forces(method: Method, pressed: list[Seen], sheared: list[Seen]) -> dict[str, float]:
    """Table I, its means, and the same two against the truth."""
    figures: dict[str, float] = {}
    for shape, name in SHAPES.items():
        straight = [s for s in pressed if s.shape == shape]
        every = [*straight, *(s for s in sheared if s.shape == shape)]
        figures[f"normal force, {name}"] = _rmse([method.normal(s) - s.normal_n for s in straight])
        figures[f"tangential force, {name}"] = _rmse([method.tangential(s) - _tangential(s.force) for s in every])
        figures[f"moment, {name}"] = _rmse([method.moment(s) - np.abs(s.force[:, 5]) for s in every])
    for name in ("tangential force", "moment"):
        figures[f"{name}, mean of the four"] = float(np.mean([figures[f"{name}, {n}"] for n in SHAPES.values()]))
    every = [*pressed, *sheared]
    figures["tangential force, against the truth"] = _rmse(
        [method.tangential(s) - _tangential(s.true_force) for s in every]
    )
    figures["moment, against the truth"] = _rmse([method.moment(s) - np.abs(s.true_force[:, 5]) for s in every])
    return figures


def _shown(method: Method, sets: dict[str, list[Seen]]) -> dict[str, float]:
    """What the paper shows in pictures only; nothing of it is in the quick subset."""
    figures: dict[str, float] = {}
    objects = [s for name, seen in sets.items() if name.startswith("object_") for s in seen]
    for is_hertzian, what in ((False, "cylinders"), (True, "balls")):
        errors = [method.bench(method.told(s)) - s.hardness for s in objects if s.is_hertzian == is_hertzian]
        if errors:
            figures[f"hardness, {what} of Fig. 9"] = _rmse(errors)
    if "too_soft" in sets:
        figures["normal force, hardness 5"] = _rmse([method.normal(s) - s.normal_n for s in sets["too_soft"]])
    if "durability" in sets:
        peaks = np.array([[method.normal(s).max(), s.normal_n.max()] for s in sets["durability"]])
        error = peaks[:, 0] - peaks[:, 1]
        figures["normal force, first ten presses"] = float(np.sqrt(np.mean(error[:N_FIRST] ** 2)))
        figures["normal force, after 10,000 presses"] = float(abs(error[-1]))
    return figures


def _rmse(errors: list[Array]) -> float:
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2))) if errors else float("nan")


def _tangential(force: Array) -> Array:
    return np.hypot(force[:, 0], force[:, 1])


@dataclass(frozen=True)
class Press:
    """What hardness is read from: force (N), area (mm2) and depth (mm), frame by frame."""

    is_hertzian: bool
    force: Array
    area: Array
    depth: Array

    def factor(self) -> float:
        return hardness_factor(self.area, self.depth, self.force)

    def inputs(self) -> Array:
        """Of the perceptron, a row for each valid frame: force, area and depth (section IV-D), (n, 3)."""
        valid = (self.depth > LEAST_DEPTH_MM) & (self.depth < MOST_DEPTH_MM)
        return np.column_stack([self.force, self.area, self.depth])[valid]


@dataclass(frozen=True)
class Hardness:
    """Shore A of a press: a line of H_m for planar contact, a perceptron for Hertzian contact."""

    planar: Array
    hertzian: Perceptron

    @classmethod
    def fit(cls, presses: list[Press], labels: Array) -> Hardness:
        flat = np.array([not p.is_hertzian for p in presses])
        factors = np.array([p.factor() for p, is_flat in zip(presses, flat, strict=True) if is_flat])
        known = np.isfinite(factors)
        inputs = [p.inputs() for p, is_flat in zip(presses, flat, strict=True) if not is_flat]
        wanted = [np.full(len(rows), label) for rows, label in zip(inputs, labels[~flat], strict=True)]
        hertzian = Perceptron.fit(np.concatenate(inputs), np.concatenate(wanted))
        return cls(line(factors[known], labels[flat][known]), hertzian)

    def __call__(self, press: Press) -> Array:
        """(1,), or empty where too few frames are at valid depths; the mean over a round press's frames."""
        if press.is_hertzian:
            rows = press.inputs()
            return np.array([self.hertzian(rows).mean()]) if len(rows) else np.zeros(0)
        factor = press.factor()
        return np.array([self.planar @ [factor, 1.0]]) if np.isfinite(factor) else np.zeros(0)


@dataclass(frozen=True)
class Method:
    """The paper's fits: slopes, or lines of slope and offset; hardness from the bench's numbers and the sensor's."""

    to_depth: Array
    gain: Array
    gamma_n: Array
    gamma_t: float
    gamma_m: float
    bench: Hardness = field(init=False)
    alone: Hardness = field(init=False)

    @classmethod
    def fit(cls, nominal: list[Seen], calibration: list[Seen], sheared: list[Seen]) -> Method:
        """All fits, in the paper's order."""
        fall = np.concatenate([s.fall for s in nominal])
        to_depth = line(fall, np.concatenate([s.gel_depth_mm for s in nominal]))

        def depth(s: Seen) -> Array:
            return np.asarray(np.maximum(to_depth[0] * s.fall + to_depth[1], 0.0))

        hard = [s for s in calibration if s.recorded.run.chosen["shore_a"] == FORCE_HARDNESS and not s.is_hertzian]
        gain = area_gain([(s.area_mm2, depth(s), s.normal_n) for s in hard])
        gamma_n = line(
            np.concatenate([gained(s.area_mm2, depth(s), gain) for s in hard]),
            np.concatenate([s.normal_n for s in hard]),
        )
        slid = np.concatenate([s.tangential for s in sheared])
        gamma_t = slope(slid, np.concatenate([_tangential(s.force) for s in sheared]))
        gamma_m = slope(slid, np.concatenate([np.abs(s.force[:, 5]) for s in sheared]))
        method = cls(to_depth, gain, gamma_n, gamma_t, gamma_m)
        labels = np.array([s.hardness for s in calibration])
        object.__setattr__(method, "bench", Hardness.fit([method.told(s) for s in calibration], labels))
        object.__setattr__(method, "alone", Hardness.fit([method.own(s) for s in calibration], labels))
        return method

    def depth(self, s: Seen) -> Array:
        return np.asarray(np.maximum(self.to_depth[0] * s.fall + self.to_depth[1], 0.0))

    def normal(self, s: Seen) -> Array:
        return np.asarray(self.gamma_n[0] * gained(s.area_mm2, self.depth(s), self.gain) + self.gamma_n[1])

    def tangential(self, s: Seen) -> Array:
        return self.gamma_t * s.tangential

    def moment(self, s: Seen) -> Array:
        return self.gamma_m * s.tangential

    def told(self, s: Seen) -> Press:
        """With the bench's force and travel, and a planar indenter's known area."""
        area = s.area_mm2 if s.is_hertzian else np.full(len(s.fall), s.known_area_mm2)
        return Press(s.is_hertzian, s.normal_n, area, s.travel_mm)

    def own(self, s: Seen) -> Press:
        """With the sensor's own force, area and depth."""
        return Press(s.is_hertzian, self.normal(s), s.area_mm2, self.depth(s))
