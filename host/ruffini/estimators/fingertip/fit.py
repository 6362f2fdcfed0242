"""Kind `fingertip`: force, way, place, angles and area from the pins of a round fingertip, followed by two eyes.

Features are the field of displacement about the touched place (`tip_field`), labels what the bench knew, turned into
the same frame. Presses are turned and mirrored (`tip_turns`), a network is fitted for both eyes and for each alone, and
what it says of presses left out of the fit gives the report and the trust in its deviations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.errors import InputError
from ruffini.estimators.fingertip.eyes import Eyes
from ruffini.estimators.fingertip.face import FaceTable, bears_all_round, fit_face, radii
from ruffini.estimators.fingertip.field import field_of, pressed
from ruffini.estimators.fingertip.network import TipNetwork, train
from ruffini.estimators.fingertip.presses import AREA, FORCE, PITCH, ROLL, WAY, Press, X, Y, axes, read_presses
from ruffini.estimators.fingertip.rim import rim_at_most, rim_motion
from ruffini.estimators.fingertip.turns import Samples, turned

Array = npt.NDArray[np.float64]
Progress = Callable[[float], None]

MODES = ("both", "left", "right")
QUANTITIES = ("force_n", "way_mm", "x_mm", "y_mm", "roll_deg", "pitch_deg", "side_mm")
ZERO = np.array([0.5, 1.0, 0, 0, 0, 0, 9.0])  # of full scale, mm, mm, mm, -, -, mm
SCALE = np.array([0.25, 0.6, 3.0, 3.0, 0.14, 0.14, 1.5])
TO_BOARD = np.array([1e6, 1e3, 1e3, 1e3, 1e6, 1e6, 1e3])  # uN, um, 1e-6
LEAST, MOST = 0.04, 1.3  # of full scale, of the presses that are used
TOUCHES = 20  # of [contact] threshold_un, the least force that counts: what the fingertip is made for
N_TURNS, N_FOLDS, N_ROUNDS = 12, 4, 30
NOISE_MM = 0.004  # of a feature
TOUCH_FACTOR = 1.3  # over the largest motion of a pin at rest
KNOWN_FACTOR = 1.5  # over the furthest features of the fit
GATE_PX = 3.0


@dataclass(frozen=True)
class Scale:
    """Labels are (told - zero) / one, (7,) each; full_n : the force that the fingertip is made for."""

    full_n: float
    zero: Array
    one: Array

    @classmethod
    def of(cls, board: Board) -> Scale:
        full_n = TOUCHES * board.contact.threshold_un * 1e-6
        force = np.array([full_n, 1, 1, 1, 1, 1, 1])
        return cls(full_n, ZERO * force, SCALE * force)

    def used(self, told: Array) -> npt.NDArray[np.bool_]:
        """Frames (t,) that are touched, told all of, and neither too faint nor too hard."""
        part = told[:, FORCE] / self.full_n
        return np.asarray(np.isfinite(told).all(axis=1) & (part > LEAST) & (part < MOST))


@dataclass(frozen=True)
class Pins:
    """A unit's pins at rest: rest (2, n, 2) px, place (n, 3) mm of their tips, normal (n, 3)."""

    rest: Array
    place: Array
    normal: Array

    @classmethod
    def of(cls, eyes: Eyes, presses: list[Press]) -> Pins:
        """From the rest pictures of all presses. Raises InputError where the eyes disagree."""
        first = presses[0].rest
        pair = eyes.pairs(*first)
        nominal = np.stack([first[eye][pair[:, eye]] for eye in range(2)])
        rest = np.mean([taken(press, nominal)[0] for press in presses], axis=0)
        place = eyes.place(rest)
        return cls(rest, place, eyes.normals(place))


def taken(press: Press, rest: Array) -> tuple[Array, Array]:
    """Rest (2, n, 2) and shifts (t, 2, n, 2) of the pins that rest near `rest`.

    Raises
    ------
    InputError
        One of them is not there.
    """
    kept, shifts = [], []
    for eye in range(2):
        apart = np.linalg.norm(rest[eye][:, None] - press.rest[eye][None], axis=2)
        own = apart.argmin(axis=1)
        if apart.min(axis=1).max() > GATE_PX or len(set(own.tolist())) < len(own):
            raise InputError(f"{press.name}: its pins at rest are not those of the other presses: leave it out")
        kept.append(press.rest[eye][own])
        shifts.append(press.moved[:, eye][:, own])
    return np.stack(kept), np.stack(shifts, axis=1)


def labels_of(told: Array, turn: Array, scale: Scale) -> Array:
    """What the network says, in units of about one, (t, 7), from told (t, 7) in the frames `turn` (t, 3, 3)."""
    out = np.zeros((len(told), 7))
    for i, row in enumerate(told):
        tool = turn[i] @ axes(*np.deg2rad(row[[ROLL, PITCH]]))
        out[i] = [row[FORCE], row[WAY], *(tool[:, :2] @ row[[X, Y]])[:2], *tool[:2, 2], np.sqrt(row[AREA])]
    return np.asarray((out - scale.zero) / scale.one)


def told_by(labels: Array, turn: Array, scale: Scale) -> Array:
    """The other way: force_n, way_mm, x_mm, y_mm, roll_deg, pitch_deg, side_mm, (t, 7)."""
    value: Array = labels * scale.one + scale.zero
    out = value.copy()
    for i, row in enumerate(value):
        tilt = np.clip(row[4:6], -0.9, 0.9)
        upright = np.sqrt(max(1 - float(tilt @ tilt), 1e-12))
        axis = turn[i].T @ [*tilt, upright]
        roll, pitch = np.arcsin(np.clip(-axis[1], -1, 1)), np.arctan2(axis[0], axis[2])
        at = turn[i].T @ [row[2], row[3], -(row[2:4] @ tilt) / upright]
        out[i, 2:4] = (axes(roll, pitch).T @ at)[:2]
        out[i, 4:6] = np.rad2deg([roll, pitch])
    return out


@dataclass(frozen=True)
class Fold:
    """Features and labels of presses, in one way of seeing; turn (t, 3, 3); told (t, 7); press (t,) their numbers."""

    features: Array
    labels: Array
    turn: Array
    told: Array
    press: npt.NDArray[np.intp]

    def of(self, numbers: npt.NDArray[np.intp]) -> Fold:
        keep = np.isin(self.press, numbers)
        return Fold(*(getattr(self, name)[keep] for name in ("features", "labels", "turn", "told", "press")))


@dataclass(frozen=True)
class Bench:
    """What every way of seeing is fitted on. touch_mm : a press of a pin that is a touch."""

    eyes: Eyes
    pins: Pins
    scale: Scale
    presses: list[Press]
    touch_mm: float


def folds(bench: Bench, mode: int, angles: Array, mirrors: tuple[bool, ...]) -> Fold:
    """All frames of presses that are felt, turned by each angle, seen by the eyes of `mode`."""
    eyes, pins = bench.eyes, bench.pins
    gain, parts = eyes.gains(pins.place)[mode], []
    for number, press in enumerate(bench.presses):
        keep = bench.scale.used(press.told)
        rest, shifts = taken(press, pins.rest)
        moved = eyes.place(rest[None] + shifts[keep]) - eyes.place(rest)[None]
        own = Samples(moved, press.told[keep])
        for angle in angles:
            for mirror in mirrors:
                some = own if not angle and not mirror else turned(own, pins.normal, float(angle), is_mirrored=mirror)
                shift = eyes.project(pins.place + some.moved) - eyes.project(pins.place)
                seen = np.einsum("ncd,tnd->tnc", gain, shift.transpose(0, 2, 1, 3).reshape(len(shift), -1, 4))
                felt = pressed(seen, pins.normal).max(axis=1) >= bench.touch_mm
                field, told = field_of(seen[felt], pins.normal, eyes.radius_mm), some.told[felt]
                labels = labels_of(told, field.turn, bench.scale)
                parts.append((field.features, labels, field.turn, told, np.full(len(labels), number)))
    return Fold(*(np.concatenate(each) for each in zip(*parts, strict=True)))


def _face(bench: Bench, straight: Fold, said: Array) -> FaceTable | None:
    """By what was said of presses left out; said (t, 7) as of `told_by`, of the frames of `straight`, by both eyes."""
    eyes, pins = bench.eyes, bench.pins
    gain, tip_mm, row, inputs = eyes.gains(pins.place)[0], tip_radius_mm(bench), 0, []
    for press in bench.presses:
        rest, shifts = taken(press, pins.rest)
        shifts = shifts[bench.scale.used(press.told)]
        moved = eyes.place(rest[None] + shifts) - eyes.place(rest)[None]
        shift = eyes.project(pins.place + moved) - eyes.project(pins.place)
        seen = np.einsum("ncd,tnd->tnc", gain, shift.transpose(0, 2, 1, 3).reshape(len(shift), -1, 4))
        for frame in seen[pressed(seen, pins.normal).max(axis=1) >= bench.touch_mm]:
            axis = axes(*np.deg2rad(said[row, 4:6]))[:, 2]
            key = radii(frame, pins.normal, straight.turn[row], axis, eyes.radius_mm, tip_mm)
            inputs.append([said[row, 0], said[row, 1], *key])
            row += 1
    is_whole = bears_all_round(straight.told, eyes.radius_mm)
    return fit_face(np.array(inputs), straight.told[:, AREA], is_whole, straight.press)


def tip_radius_mm(bench: Bench) -> float:
    """Of the sphere on which the pins' tips stand."""
    return float(np.linalg.norm(bench.pins.place + np.array([0, 0, bench.eyes.radius_mm]), axis=1).mean())


@dataclass(frozen=True)
class ModeFit:
    """One way of seeing. trust (7,): true over stated deviations of presses left out; near (k,): weights of the
    components' squares in how far features are from those of the fit; limits (2,): of that, and of what the components
    leave of a feature, mm; left_out : mean errors of presses left out; face : of both eyes, if enough presses tell it.
    """

    network: TipNetwork
    trust: Array
    near: Array
    limits: Array
    left_out: dict[str, float]
    face: FaceTable | None = None


@dataclass(frozen=True)
class TipFit:
    """Tables of a unit's fingertip: one of `modes` for each of MODES."""

    bench: Bench
    modes: list[ModeFit]
    report: dict[str, Any]


def fit_fingertip(board: Board, presses_at: Path, baseline_mm: float, progress: Progress, *, only: str = "*") -> TipFit:
    """Fit a unit's fingertip from its presses.

    Raises
    ------
    InputError
        There are too few presses, or a file is not as it should be.
    """
    eyes = Eyes.of(board, baseline_mm)
    presses = read_presses(board, presses_at, only, lambda done: progress(0.3 * done))
    scale = Scale.of(board)
    presses = [press for press in presses if scale.used(press.told).any()]
    if len(presses) < 2 * N_FOLDS:
        least, most = (part * scale.full_n for part in (LEAST, MOST))
        raise InputError(
            f"{presses_at} has {len(presses)} presses of {least:g} to {most:g} N: {2 * N_FOLDS} are needed"
        )
    pins = Pins.of(eyes, presses)
    touch_mm = TOUCH_FACTOR * max(_motion_at_rest(eyes, pins, press) for press in presses)
    bench, modes = Bench(eyes, pins, scale, presses, touch_mm), []
    for mode in range(len(MODES)):
        modes.append(_fit_mode(bench, mode))
        progress(0.3 + 0.7 * len(modes) / len(MODES))
    report = {
        "n_presses": len(presses),
        "largest_n": scale.full_n,
        "n_pins": len(pins.place),
        "mean_error_of_presses_left_out": {name: mode.left_out for name, mode in zip(MODES, modes, strict=True)},
        "face": None if modes[0].face is None else modes[0].face.report,
        "rim_px": [round(float(px), 3) for px in _rim_of(bench)],
    }
    return TipFit(bench, modes, report)


def _rim_of(bench: Bench) -> Array:
    """Shift and zoom of the outermost pins that the largest force of the fit is allowed, px, (2,)."""
    motion, load = [], []
    for press in bench.presses:
        rest, shifts = taken(press, bench.pins.rest)
        is_used = bench.scale.used(press.told)
        for eye in range(2):
            motion.append(rim_motion(rest[eye], shifts[is_used, eye]))
            load.append(press.told[is_used, FORCE] / (MOST * bench.scale.full_n))
    return rim_at_most(np.concatenate(motion), np.concatenate(load))


def _fit_mode(bench: Bench, mode: int) -> ModeFit:
    n_turns = N_TURNS if mode == 0 else (N_TURNS + 1) // 2  # one eye alone is for an accident: half the time will do
    angles = np.arange(n_turns) * 2 * np.pi / n_turns
    every = folds(bench, mode, angles, (False, True))
    straight = folds(bench, mode, angles[:1], (False,))
    off, sigma, rows = _left_out(every, straight, len(bench.presses), bench.scale)
    network = train(every.features, every.labels, rounds=N_ROUNDS, noise=NOISE_MM)
    near = 1 / network.components(every.features).var(axis=0)
    left_out = {q: round(float(e), 4) for q, e in zip(QUANTITIES, np.abs(off).mean(axis=0), strict=True)}
    trust = np.sqrt(np.mean((off / sigma) ** 2, axis=0))
    face = None
    if mode == 0:
        said = np.zeros_like(off)
        said[rows] = off
        face = _face(bench, straight, said + told_by(straight.labels, straight.turn, bench.scale))
    return ModeFit(network, trust, near, KNOWN_FACTOR * _furthest(network, near, every.features), left_out, face)


def _left_out(every: Fold, straight: Fold, n: int, scale: Scale) -> tuple[Array, Array, npt.NDArray[np.intp]]:
    """Errors and stated deviations (t, 7) of presses that their network has not seen, in the units of QUANTITIES.

    And which frames of `straight` they are of.
    """
    part = np.random.default_rng(0).permutation(n) % N_FOLDS
    off, sigma, rows = [], [], []
    for fold in range(N_FOLDS):
        kept, left = every.of(np.flatnonzero(part != fold)), straight.of(np.flatnonzero(part == fold))
        network = train(kept.features, kept.labels, rounds=N_ROUNDS, noise=NOISE_MM)
        mean, deviation = network(left.features)
        off.append(told_by(mean, left.turn, scale) - told_by(left.labels, left.turn, scale))
        rows.append(np.flatnonzero(np.isin(straight.press, np.flatnonzero(part == fold))))
        sigma.append(deviation * scale.one * [1, 1, 1, 1, *2 * [np.rad2deg(1.0)], 1])
    return np.concatenate(off), np.concatenate(sigma), np.concatenate(rows)


def _furthest(network: TipNetwork, near: Array, features: Array) -> Array:
    """Largest whitened square and largest root mean square that the components leave, of features of the fit."""
    z = network.components(features)
    length = 1 / np.linalg.norm(network.projection, axis=1)
    left = ((features - network.mean) ** 2).sum(axis=1) - ((z * length) ** 2).sum(axis=1)
    return np.array([(z**2 @ near).max(), np.sqrt(max(left.max(), 0) / features.shape[1])])


def _motion_at_rest(eyes: Eyes, pins: Pins, press: Press) -> float:
    shifts = taken(press, pins.rest)[1]
    shifts = shifts[~np.isfinite(press.told[:, FORCE])]
    if not len(shifts):
        return 0.0
    gain = eyes.gains(pins.place)[0]
    seen = np.einsum("ncd,tnd->tnc", gain, shifts.transpose(0, 2, 1, 3).reshape(len(shifts), -1, 4))
    return float(pressed(seen, pins.normal).max())
