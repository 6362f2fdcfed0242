"""The estimator of a fingertip with pins, in whole numbers: field about the touched place, network, turned back."""

from __future__ import annotations

from collections.abc import Callable
from math import isqrt
from typing import Any

import numpy as np
import numpy.typing as npt

Ints = npt.NDArray[np.int64]
ONE, MILLION = 1 << 14, 1_000_000


def round_shift(x: Any, n: int) -> Any:
    return (x + (1 << (n - 1))) >> n


def rounded_div(top: Any, bottom: Any) -> Any:
    return (2 * top + bottom) // (2 * bottom)


def atan2_urad(y: int, x: int) -> int:
    """CORDIC with angles to 1e-9 rad."""
    if x == 0 and y == 0:
        return 0
    angle = 0
    if x < 0:
        angle, x, y = (-3141592654 if y < 0 else 3141592654), -x, -y
    x, y = x * 1024, y * 1024
    for i in range(22):
        step = round(float(np.arctan(2.0**-i)) * 1e9)
        sign = 1 if y > 0 else -1
        x, y, angle = x + sign * (y >> i), y - sign * (x >> i), angle + sign * step
    return (angle + 500) // 1000


def areas(t: dict[str, Ints], field: Callable[[Ints], Ints], axis: Ints, force: int, way: int) -> list[int]:
    """Flat area and its deviation, face's area and its deviation, um^2: firmware/stages/fingertip/tip_area.h."""
    rays, tip, cell = t["ray"], int(t["tip"][0]), t["cell"]
    n_rays, n_rings = rays.shape[:2]
    h = np.array([
        [int((axis * (round_shift(tip * g, 14) + field(g))).sum()) // 1_000_000 for g in ray] for ray in rays
    ])  # fmt: skip
    order = sorted((-int(h[k, i]), k * n_rings + i) for k in range(n_rays) for i in range(n_rings))
    area = total = 0
    for minus, index in order:
        if area >= 6_000_000:
            break
        area += int(cell[index % n_rings])
        total -= int(cell[index % n_rings]) * minus
    top = total // area

    def above(height: int) -> int:
        return int((cell * (h > height)).sum())

    flat, change = above(top - 4800), above(top - 4800 - 1120) - above(top - 4800 + 1120)
    ridge = 2 + h[:, 2:19].argmax(axis=1)
    bend = 3 + (2 * h[:, 3:19] - h[:, 5:21] - h[:, 1:17]).argmax(axis=1)
    radius = [isqrt((int((r * np.roll(r, -1)).sum()) << 16) // n_rays) for r in (bend, ridge)]
    values, parts = t["face"].reshape(*t["face_axis"][:, 2], 3), []
    for i, at in enumerate((force, way, *radius)):
        zero, step, count = t["face_axis"][i].tolist()
        place = min(max(at - zero, 0), step * (count - 1))
        low = min(place // step, count - 2)
        parts.append(((place - low * step) << 12) // step)
        values = values.take([low, low + 1], axis=i)
    for part in reversed(parts):  # the last input first
        values = values[..., 0, :] + round_shift((values[..., 1, :] - values[..., 0, :]) * part, 12)
    area_1e3, part_q16, whole_q16 = values.tolist()
    face = [area_1e3 * 1000, max(area_1e3 * part_q16 * 1000 >> 16, 1)] if whole_q16 >= 45_875 else [0, 0]
    return [flat, max(change // 2, int(cell[-1])), *face]


def still_of(gain: Ints) -> Ints:
    """What no motion of a pin makes, (4,) Q14: square to the rows of M (3, 4)."""
    m = gain.copy()
    while np.abs(m).max() >= 1 << 19:
        m >>= 1
    n = []
    for left_out in range(4):
        a, b, c = (m[:, i] for i in range(4) if i != left_out)
        n.append((-1) ** left_out * int((a * np.cross(b, c)).sum()))
    while max(abs(v) for v in n) >= 1 << 29:
        n = [v >> 1 for v in n]
    length = max(isqrt(sum(v * v for v in n)), 1)
    return np.array([v * ONE // length for v in n])


class Fingertip:
    """Tensors of kind `fingertip` by their names without it; `most_un` of the manifest."""

    def __init__(self, tensors: dict[str, npt.NDArray[Any]], most_un: int) -> None:
        self.t = {name.removeprefix("fingertip."): np.asarray(v, np.int64) for name, v in tensors.items()}
        self.most_un = most_un
        self.marker = np.full((2, len(self.t["normal"])), -1)
        self.still = np.array([still_of(m) for m in self.t["gain"][0]])
        self.n_contradicted = 0
        self.n_saturated = 0

    def learn(self, rest_q16: Ints, is_absent: Ints) -> None:
        """Markers (2, m, 2) at rest."""
        gate2 = int(self.t["gate"][0]) ** 2
        for eye in range(2):
            for p, place in enumerate(self.t["rest"][eye]):
                away = ((rest_q16[eye] >> 8) - place) ** 2
                away2 = np.where(is_absent[eye] != 0, gate2, away.sum(axis=1))
                best = int(away2.argmin())
                self.marker[eye, p] = best if away2[best] < gate2 else -1

    def _held(self, values: Ints, limit: int) -> Ints:
        self.n_saturated += int((np.abs(values) > limit).sum())
        return np.clip(values, -limit, limit)

    def field(self, moved_q16: Ints, quality: Ints, eyes: int) -> tuple[Ints, Ints, Ints] | None:
        """Features (3 g + 2,), R (3, 3), c (3,); None where nothing presses. Quality (2, m), 0 of lost markers."""
        seeing = [[0, 1], [0], [1]][eyes]
        there = (self.marker >= 0)[seeing].all(axis=0)
        sure = np.array([(self.marker[e] >= 0) & (quality[e][self.marker[e]] >= 30) for e in range(2)])
        there &= sure[seeing].all(axis=0)
        shift = np.zeros((len(there), 4), np.int64)
        for eye in range(2):
            moved = np.clip(moved_q16[eye][self.marker[eye]], -(1 << 24), 1 << 24)
            shift[:, 2 * eye : 2 * eye + 2] = np.where(sure[eye][:, None], moved, 0)
        apart = np.abs(round_shift((self.still * shift).sum(axis=1), 14))
        most = 8192 + np.array([isqrt(v) for v in (shift**2).sum(axis=1).tolist()]) // 32
        contradicted = sure.all(axis=0) & (apart > most)
        self.n_contradicted = int(contradicted.sum())
        there &= ~contradicted
        normal, shift, gain = self.t["normal"][there], shift[there], self.t["gain"][eyes][there]
        limit = 1 << 18
        u = np.clip(round_shift((gain * shift[:, None]).sum(axis=2), 20), -limit, limit)
        press = -round_shift((u * normal).sum(axis=1), 14)
        most = int(press.max(initial=0))
        if most < self.t["gate"][1]:
            return None
        weight = np.maximum(press - (most * 77 >> 8), 0)
        total = (weight[:, None] * normal).sum(axis=0)
        while np.abs(total).max() >= 1 << 30:
            total = round_shift(total, 1)
        length = max(isqrt(int((total**2).sum())), 1)
        c = (total * ONE * 2 + length) // (2 * length)
        part = (c[:, None] * c[None, :] + (ONE + c[2]) // 2) // (ONE + c[2])
        r = np.array([[ONE - part[0, 0], -part[0, 1], -c[0]], [-part[0, 1], ONE - part[1, 1], -c[1]], c])
        v, n = round_shift(u @ r.T, 14), round_shift(normal @ r.T, 14)

        def kernel_mean(g: Ints) -> Ints:
            step = ((n - g) ** 2).sum(axis=1) >> 13
            k = np.where(step < 2048, self.t["kernel"][np.minimum(step, 2047)], 0)
            return np.asarray(rounded_div((k[:, None] * v).sum(axis=0), int(k.sum()) + (1 << 15) // 20))

        self.kernel_mean = kernel_mean
        out = [v for g in self.t["place"] for v in kernel_mean(g).tolist()]
        out += round_shift(c[:2] * 8000, 14).tolist()
        return np.array(out), r, c

    def network(self, features: Ints, eyes: int) -> tuple[Ints, bool]:
        """Outputs (14,) Q16, and whether the features are known."""
        t = {name: values[eyes] for name, values in self.t.items() if name[:4] in ("mean", "weig", "bias", "near",
             "leng", "limi")}  # fmt: skip
        x = self._held(features - t["mean"], 1 << 20)
        z = self._held(round_shift(t["weight0"] @ x, 12), 1 << 22)
        far = int(round_shift((z >> 8) ** 2 * t["near"], 12).sum())
        left = int((x**2).sum() - (round_shift(z * t["length"], 16) ** 2).sum())
        level = z
        for i in range(1, 4):
            level = self._held(round_shift((t[f"bias{i}"] << 16) + t[f"weight{i}"] @ level, 16), 1 << 24)
            level = np.maximum(level, 0) if i < 3 else level
        return level, far <= t["limit"][0] << 16 and left <= int(t["limit"][1]) ** 2 * len(x)

    def run(self, moved_q16: Ints, quality: Ints, eyes: int) -> list[int]:
        """A row as of the C interface's slot `tip`."""
        found = self.field(moved_q16, quality, eyes)
        if found is None:
            return [0, 1, 1] + [0] * 16
        features, r, _ = found
        out, is_known = self.network(features, eyes)
        value = self._held(self.t["zero"] + round_shift(out[:7] * self.t["scale"], 16), 1 << 30).tolist()
        sigma = []
        rows = zip(out[7:].tolist(), self.t["scale"].tolist(), self.t["trust"][eyes].tolist(), strict=True)
        for log2, scale, trust in rows:
            q = min(max(log2, -12 * 65536), 8 * 65536)
            whole, mantissa = q >> 16, 65536 + (q & 65535)
            power = mantissa << whole if whole >= 0 else mantissa >> -whole
            sigma.append(round_shift(round_shift(scale * power, 16) * trust, 8))
        sigma = np.maximum(self._held(np.array(sigma), 1 << 28), 1).tolist()
        force = max(value[0], 0)
        place, tilt = (isqrt((sigma[a] ** 2 + sigma[a + 1] ** 2) // 2) for a in (2, 4))
        *turned, axis = self._turned_back(value, r)
        row = [1, int(is_known), int(force <= self.most_un), force, value[1], *turned]
        area_sigma = 2 * abs(value[6]) * sigma[6]
        area = value[6] ** 2 if 5 * area_sigma <= value[6] ** 2 else 0
        flat = [0, 0]
        if "ray" in self.t and eyes == 0:
            *flat, face, face_sigma = areas(
                self.t, self.kernel_mean, round_shift(r @ np.array(axis), 14), force, value[1]
            )
            if not area and is_known and face and 5 * face_sigma <= face:
                area, area_sigma = face, face_sigma
        return [*row, area, sigma[0], sigma[1], place, place, tilt, tilt, area_sigma, *flat]

    @staticmethod
    def _turned_back(value: list[int], r: Ints) -> list[Any]:
        def root(a: int, b: int) -> int:
            return max(isqrt(max(MILLION**2 - a * a - b * b, 0)), 1)

        def back(v: list[int]) -> list[int]:
            return [int(a) for a in round_shift(np.array(v) @ r, 14)]

        tx, ty = (min(max(v, -900_000), 900_000) for v in value[4:6])
        if (tilt := isqrt(tx * tx + ty * ty)) > 900_000:
            tx, ty = (rounded_div(v * 900_000, tilt) for v in (tx, ty))
        tz = root(tx, ty)
        t = back([tx, ty, tz])
        cos_roll = root(t[1], 0)
        at = back([value[2], value[3], rounded_div(-(value[2] * tx + value[3] * ty), tz)])
        sin_pitch, cos_pitch = (min(max(rounded_div(of * MILLION, cos_roll), -MILLION), MILLION) for of in (t[0], t[2]))
        level = rounded_div(sin_pitch * at[0] + cos_pitch * at[2], MILLION)
        x = rounded_div(cos_pitch * at[0] - sin_pitch * at[2], MILLION)
        y = rounded_div(cos_roll * at[1] - t[1] * level, MILLION)
        return [x, y, atan2_urad(-t[1], cos_roll), atan2_urad(t[0], t[2]), t]
