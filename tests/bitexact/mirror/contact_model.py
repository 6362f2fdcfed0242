"""Profile of a flow, perceptrons, and what a contact model makes of them.

Python integers where a number stands alone, so that nothing can overflow.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import isqrt

import numpy as np
import numpy.typing as npt

from mirror.board import Board
from mirror.fixed import I64, Saturations, div_half_up, round_shift

Tensors = dict[str, npt.NDArray[np.generic]]
NETS = ("size", "kind", "fails", "planar", "hertzian")
N_RINGS, N_ANGLES, ONE = 16, 32, 1 << 14
COSINE = np.round(np.cos(2 * np.pi * np.arange(N_ANGLES) / N_ANGLES) * ONE).astype(np.int64)
SINE = np.roll(COSINE, N_ANGLES // 4)


@dataclass(frozen=True)
class Profile:
    """As firmware/stages/contact_model/contact_profile.h has it."""

    radial: list[int]
    size: int
    fall: int
    center: tuple[int, int]
    lost: int
    flow: int

    def row(self) -> list[int]:
        return [*self.radial, self.size, self.fall, *self.center, self.lost, self.flow]


def _smoothed(fall: I64) -> I64:
    edged = np.pad(fall, 1, mode="edge")
    along = edged[:, :-2] + 2 * edged[:, 1:-1] + edged[:, 2:]
    return round_shift(along[:-2] + 2 * along[1:-1] + along[2:], 4)


def _catmull(t: int) -> list[int]:
    t2 = int(round_shift(np.int64(t * t), 14))
    t3 = int(round_shift(np.int64(t2 * t), 14))
    before, here, beyond = (2 * t2 - t - t3 + 1) >> 1, ONE + ((3 * t3 - 5 * t2 + 1) >> 1), (t3 - t2 + 1) >> 1
    return [before, here, ONE - before - here - beyond, beyond]


class ContactProfile:
    """From displacements (n, 2) px Q16 and what is lost (n,)."""

    def __init__(self, board: Board) -> None:
        m, camera, pad = board["markers"], board["camera"], board["pad"]
        self._shape = (m["n_y"], m["n_x"])
        self._scale = camera["standoff_um"] * 1000 * 2**20 // (camera["focal_mpx"] << 12)
        self._pitch = [m["pitch_x_um"] << 4, m["pitch_y_um"] << 4]
        self._first = [(2 * m[f"first_{a}_um"] - pad[f"size_{a}_um"]) << 3 for a in "xy"]
        self._n = [m["n_x"], m["n_y"]]
        self._last = [f + (n - 1) * p for f, n, p in zip(self._first, self._n, self._pitch, strict=True)]
        self._ring = min(pad["size_x_um"], pad["size_y_um"]) // 36

    def flow(self, moved: I64) -> I64:
        """Displacements of the patches, 1/16 um."""
        return round_shift(moved * self._scale, 20).reshape(*self._shape, 2)

    def fall(self, flow: I64) -> I64:
        """Smoothed fall of the density at the patches, Q16."""
        raw = np.zeros(self._shape, np.int64)
        raw[1:-1, 1:-1] = ((flow[1:-1, 2:, 0] - flow[1:-1, :-2, 0]) << 15) // self._pitch[0]
        raw[1:-1, 1:-1] += ((flow[2:, 1:-1, 1] - flow[:-2, 1:-1, 1]) << 15) // self._pitch[1]
        return _smoothed(raw)

    def run(self, moved: I64, lost: I64) -> Profile:
        flow = self.flow(moved)
        fall = self.fall(flow)
        largest = max(int(fall.max()), 0)
        at = [f + p * np.arange(n) for f, p, n in zip(self._first, self._pitch, self._n, strict=True)]
        middle = self._center(fall, largest, at)
        radial = [self._radial(flow, middle, (k + 1) * self._ring << 4) for k in range(N_RINGS)]
        away = (at[0] - middle[0])[None, :] ** 2 + (at[1] - middle[1])[:, None] ** 2
        near = away <= (N_RINGS * self._ring << 4) ** 2
        n_near = int(near.sum())
        part = 1000 * int((lost.reshape(self._shape)[near] != 0).sum()) // n_near if n_near else 1000
        center = (middle[0] + 8) >> 4, (middle[1] + 8) >> 4
        total = flow.reshape(-1, 2).sum(axis=0).tolist()
        mean = isqrt(total[0] ** 2 + total[1] ** 2) // (flow.size // 2)
        return Profile(radial, isqrt(sum(r * r for r in radial)), largest, center, part, mean)

    @staticmethod
    def _center(fall: I64, largest: int, at: list[I64]) -> tuple[int, int]:
        weight = np.maximum(fall - 3 * largest // 10, 0)
        total = int(weight.sum())
        if total == 0:
            return 0, 0
        moments = int((weight * at[0][None, :]).sum()), int((weight * at[1][:, None]).sum())
        return (2 * moments[0] + total) // (2 * total), (2 * moments[1] + total) // (2 * total)

    def _is_inside(self, x: int, y: int) -> bool:
        return self._first[0] <= x <= self._last[0] and self._first[1] <= y <= self._last[1]

    def _flow_at(self, flow: I64, x: int, y: int) -> tuple[int, int]:
        places = [(v - f) * ONE // p for v, f, p in zip((x, y), self._first, self._pitch, strict=True)]
        line = [min(v >> 14, n - 2) for v, n in zip(places, self._n, strict=True)]
        across, down = (_catmull(v - i * ONE) for v, i in zip(places, line, strict=True))
        columns = np.clip(line[0] + np.arange(-1, 3), 0, self._n[0] - 1)
        rows = np.clip(line[1] + np.arange(-1, 3), 0, self._n[1] - 1)
        patch = flow[np.ix_(rows, columns)]
        total = np.einsum("j,i,jic->c", np.array(down), np.array(across), patch)
        return int(round_shift(total, 28)[0]), int(round_shift(total, 28)[1])

    def _radial(self, flow: I64, middle: tuple[int, int], radius: int) -> int:
        total = n = 0
        for c, s in zip(COSINE[: N_ANGLES // 2].tolist(), SINE[: N_ANGLES // 2].tolist(), strict=True):
            dx, dy = (radius * c + (ONE >> 1)) >> 14, (radius * s + (ONE >> 1)) >> 14
            here, there = (middle[0] + dx, middle[1] + dy), (middle[0] - dx, middle[1] - dy)
            if self._is_inside(*here) and self._is_inside(*there):
                a, b = self._flow_at(flow, *here), self._flow_at(flow, *there)
                total += (a[0] - b[0]) * c + (a[1] - b[1]) * s
                n += 2
        return (2 * total + n * ONE) // (2 * n * ONE) if n else 0


def log2_q10(x: int) -> int:
    """Bit by bit."""
    if x < 1:
        return 0
    whole = x.bit_length() - 1
    rest = x >> (whole - 30) if whole > 30 else x << (30 - whole)
    out = whole
    for _ in range(10):
        rest = rest * rest >> 30
        out = 2 * out + (rest >> 31)
        rest >>= rest >> 31
    return out


def inputs_of(profile: Profile, press_un: int) -> list[int]:
    size = max(profile.size, 1)
    shape = div_half_up(np.array(profile.radial) << 14, size).tolist()
    return [*shape, log2_q10(size), log2_q10(press_un // 1000)]


class Perceptron:
    """One hidden layer; `name` as in the calibration."""

    def __init__(self, tensors: Tensors, name: str) -> None:
        self._hidden, self._out = (np.asarray(tensors[f"{name}_{p}"]).astype(np.int64) for p in ("hidden", "out"))
        self._shift = [int(s) for s in tensors[f"{name}_shift"]]
        self._tanh = np.asarray(tensors["contact_model.tanh"]).astype(np.int64)

    def __call__(self, x: list[int]) -> list[int]:
        a = round_shift(self._hidden @ np.array([*x, 1 << 14]), self._shift[0])
        unit = np.sign(a) * np.array([tanh(self._tanh, int(v)) for v in np.abs(a)])
        return [int(y) for y in round_shift(self._out @ np.append(unit, 1 << 15), self._shift[1])]


def tanh(table: I64, size: int) -> int:
    """Q15, of a size in Q12."""
    held = min(size, 512 << 6)
    i = min(held >> 6, 511)
    part = held - (i << 6)
    return int((table[i] * (64 - part) + table[i + 1] * part + 32) >> 6)


def slope(x: tuple[int, ...], y: tuple[int, ...], scale: int) -> int:
    """Of y over x by least squares, times scale."""
    n = len(x)
    spread = n * sum(v * v for v in x) - sum(x) ** 2
    return (n * sum(a * b for a, b in zip(x, y, strict=True)) - sum(x) * sum(y)) * scale // spread if spread > 0 else 0


@dataclass
class Press:
    n: int = 0
    weight: int = 0
    kind: int = 0
    strange: int = 0
    fails: int = 0
    shore: list[int] = field(default_factory=lambda: [0, 0])
    deepest: int = 0
    rows: list[tuple[int, int, int, int, int]] = field(
        default_factory=list
    )  # depth, pressure, log2 of size, force, radius


class ContactModel:
    """The tables of kind `contact_model`, and the press so far; `said` is in the order of the C interface."""

    def __init__(self, tensors: Tensors, numbers: dict[str, int]) -> None:
        self._nets = {k: Perceptron(tensors, f"contact_model.{k}") for k in NETS}
        self._tanh = np.asarray(tensors["contact_model.tanh"]).astype(np.int64)
        self._white, self._mean, self._sigma, self._odds = (
            np.asarray(tensors[f"contact_model.{k}"]).astype(np.int64) for k in ("whitening", "mean", "sigma", "odds")
        )
        self._numbers = numbers
        self._forget()

    def _forget(self) -> None:
        self._press, self._is_interrupted, self._n_unseen, self._seen_us = Press(), False, 0, 0

    def _watch_gap(self, is_seen: bool, capture_us: int) -> None:
        self._n_unseen = 0 if is_seen else self._n_unseen + 1
        if self._n_unseen > 2 or (is_seen and self._seen_us and capture_us > self._seen_us + 500_000):
            self._press, self._is_interrupted = Press(), True
        if is_seen:
            self._seen_us = capture_us

    def run(
        self, profile: Profile, wrench: list[int], is_believed: bool, saturations: Saturations, capture_us: int = 0
    ) -> list[int]:
        press_un = -wrench[2]
        is_seen = is_believed and profile.lost <= 250
        self._watch_gap(is_seen, capture_us)
        if profile.fall < self._numbers["least_fall_q16"] or press_un < self._numbers["least_force_un"]:
            if is_seen:
                self._forget()
            return [0] * 14
        x = inputs_of(profile, press_un)
        y = self._nets["size"](x)

        def held(value: int) -> int:
            saturations.count += int(value > 20_000)
            return min(max(value, 0), 20_000)

        gel, press = (held((min(max(v, 0), 1 << 20) * profile.size + (1 << 15)) >> 16) for v in y[:2])
        press = max(press, gel)
        area, effective = held(y[2]) ** 2, held(y[3]) ** 2
        if is_seen and not self._is_interrupted and gel <= 2500:
            self._remember(x, profile, gel, effective, wrench)
        moment = (profile.flow * self._numbers["moment_per_flow"] + 8) >> 4
        return [1, *self._told()[:2], gel, press, self._numbers["depth_sigma_um"], area, effective, *self._told()[2:],
                (profile.flow + 8) >> 4, moment]  # fmt: skip

    def _remember(self, x: list[int], profile: Profile, gel: int, effective: int, wrench: list[int]) -> None:
        p = self._press
        is_back = gel + 50 < p.deepest
        p.deepest = max(p.deepest, gel)
        press_mn, side = -wrench[2] // 1000, [int(v / 1000) for v in wrench[:2]]
        is_straight = side[0] ** 2 + side[1] ** 2 <= (press_mn // 10) ** 2
        if not 400 <= gel <= 1800 or is_back or not is_straight:
            return
        p.n += 1
        p.weight += gel
        p.kind += gel * min(max(self._nets["kind"](x)[0], -(1 << 16)), 1 << 16)
        p.fails += gel * min(max(self._nets["fails"](x)[0], -(1 << 16)), 1 << 16)
        for k, name in enumerate(("planar", "hertzian")):
            p.shore[k] += gel * min(max(self._nets[name](x)[0], 0), 1600)
        z = round_shift(self._white @ (np.array(x[:N_RINGS]) - self._mean), 20).clip(-(1 << 20), 1 << 20)
        p.strange += gel * (int((z * z).sum()) // (N_RINGS << 8))
        pressure = min(-wrench[2] * 1_000_000 // max(effective, 1), 100_000_000)
        out = [max(r, 0) for r in profile.radial]
        radius = sum((i + 1) * r for i, r in enumerate(out)) * 1024 // sum(out) if sum(out) else 0
        p.rows.append((gel, pressure, x[16], x[17], log2_q10(radius)))

    def _told(self) -> list[int]:
        """Kind, sure, H_m, Shore A, its sigma, strange."""
        p = self._press
        if p.n < 3:
            return [0] * 6
        depth, pressure, size, force, radius = zip(*p.rows, strict=True)
        signs = [p.kind // p.weight, *(min(max(slope(size, y, 4096), -(1 << 16)), 1 << 16) for y in (force, radius))]
        told = sum(int(w) * s for w, s in zip(self._odds[1:], signs, strict=True))
        odds = int(self._odds[0]) + ((told + (1 << 11)) >> 12)
        kind = 0 if odds > 0 else 1
        sure = 500 + (500 * tanh(self._tanh, abs(odds) // 2) >> 15)
        shore = p.shore[kind] // p.weight
        is_strange = p.strange // p.weight > self._numbers["most_strange_q8"]
        is_strange |= p.fails // p.weight > self._numbers["most_failing_q12"]
        return [
            kind + 1,
            sure,
            slope(depth, pressure, 1),
            shore,
            int(self._sigma[kind, min(shore // 160, 9)]),
            int(is_strange),
        ]
