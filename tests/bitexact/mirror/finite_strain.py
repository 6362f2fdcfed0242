"""Second order of finite strain: firmware/solve/finite_strain.h, in 64 bits with every 32-bit sum asserted."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from mirror.block_float import shifted
from mirror.fixed import I64, Saturations, round_shift

WAVE_FRACTION = 11
AMPLITUDE_BITS = 13
PLANE_FRACTION = 4
PLANE_LIMIT = 1 << 22
PRESSURE_FRACTION, PRESSURE_LIMIT = 12, (1 << 15) - 1
GRADIENT_LIMIT = 1 << 14
SLOPE_FRACTION = 15
SUM_FRACTION, SUM_LIMIT = 12, 1 << 58
CORNERS = [(z, y, x) for z in (1, -1) for y in (-1, 1) for x in (-1, 1)]


def _in_32(x: I64) -> I64:
    assert np.abs(x).max(initial=0) < 1 << 31
    return x


def _shift(x: I64, right: int) -> I64:
    return np.array([shifted(int(v), right) for v in x.ravel()], np.int64).reshape(x.shape)


def narrow(x: I64) -> tuple[I64, int]:
    """x 2^-shift within 14 bits and sign, and the shift."""
    largest = int(np.abs(x).max(initial=0))
    shift = max((largest + (largest >> 13)).bit_length() - 14, 0)
    return (round_shift(x, shift) if shift else x), shift


class FiniteStrain:
    def __init__(self, tensors: dict[str, npt.NDArray[np.generic]], metadata: dict[str, str]) -> None:
        def table(name: str) -> I64:
            return tensors[f"finite_strain.{name}"].astype(np.int64)

        def integer(name: str) -> int:
            return int(metadata[f"finite_strain.{name}"])

        self.cos_x, self.sin_x, self.mid_x = (
            table("cos_x"),
            table("sin_x"),
            table("mid_x"),
        )
        self.cos_y, self.sin_y, self.mid_y = (
            table("cos_y"),
            table("sin_y"),
            table("mid_y"),
        )
        self.extension, self.pressure = table("extension"), table("pressure")
        self.slope, self.area, self.volume = (
            table("slope"),
            table("area"),
            table("volume"),
        )
        self.extension_shift, self.pressure_shift = (
            integer("extension_shift"),
            integer("pressure_shift"),
        )
        self.volume_shift = integer("volume_shift")
        self.gain, self.gain_shift = integer("gain"), integer("gain_shift")

    def force(self, u: I64, saturations: Saturations) -> I64:
        """Force steps (n_nodes, 3) to be added, from displacement (n_nodes, 3)."""
        n_y, n_x = self.cos_y.shape[1], self.cos_x.shape[1]
        largest = int(np.abs(u).max(initial=0))
        if largest == 0:
            return np.zeros((n_y * n_x, 3), np.int64)
        amplitude = max(AMPLITUDE_BITS - largest.bit_length(), 0)
        field = (u.reshape(n_y, n_x, 3) << amplitude).transpose(2, 0, 1)
        wave, exponent = self._waves(field)
        n = len(self.extension)
        planes = []
        for table in self.extension:
            b, shift = narrow(_in_32((table * wave[None]).sum(axis=1)))
            field, e = self._at_nodes(b)
            e += exponent + shift - self.extension_shift
            planes.append(saturations.clamp(_shift(field, -(e + PLANE_FRACTION)), -PLANE_LIMIT, PLANE_LIMIT))
        planes.append(np.zeros_like(planes[0]))
        load = [np.zeros_like(planes[0]) for _ in planes]
        total = np.zeros_like(wave)
        for k in range(n):
            b, shift = narrow(_in_32((self.pressure[k] * wave).sum(axis=0)))
            field, e = self._at_middles(b)
            e += exponent + shift - self.pressure_shift
            pressure = saturations.clamp(_shift(field, -(e + PRESSURE_FRACTION)), -PRESSURE_LIMIT, PRESSURE_LIMIT)
            square = self._layer(k, planes[k], planes[k + 1], pressure, load, saturations)
            w, e = self._mid_waves(square)
            e += self.volume_shift + self.extension_shift - self.pressure_shift
            total += saturations.clamp(_shift(self.pressure[k] * w, -(e + SUM_FRACTION)), -SUM_LIMIT, SUM_LIMIT)
        for k in range(n):
            w, e = self._waves(load[k])
            work = _in_32((self.extension[k] * w[:, None]).sum(axis=0))
            total += saturations.clamp(_shift(work, -(e + SUM_FRACTION)), -SUM_LIMIT, SUM_LIMIT)
        b, shift = narrow(total)
        field, e = self._at_nodes(b)
        e += shift - SUM_FRACTION - self.extension_shift - 2 * amplitude - self.gain_shift
        return saturations.int32(_shift(field * self.gain, -e)).transpose(1, 2, 0).reshape(-1, 3)

    def _layer(
        self,
        k: int,
        upper: I64,
        lower: I64,
        pressure: I64,
        load: list[I64],
        saturations: Saturations,
    ) -> I64:
        """Adds an element layer's nodal forces; returns its tr H^2 times volume."""
        difference = np.zeros((3, 3, *pressure.shape), np.int64)
        for corner in CORNERS:
            value = _corner(upper if corner[0] > 0 else lower, corner)
            for j in range(3):
                difference[:, j] += corner[2 - j] * value
        h = np.zeros_like(difference)
        for j in range(3):
            slope = int(self.slope[k, j])
            limit = (GRADIENT_LIMIT << SLOPE_FRACTION) // slope
            h[:, j] = round_shift(
                _in_32(saturations.clamp(difference[:, j], -limit, limit) * slope),
                SLOPE_FRACTION,
            )
        square = _in_32(np.einsum("kiyx,jkyx->ijyx", h, h))
        stress = round_shift(_in_32(2 * pressure * h.transpose(1, 0, 2, 3) - square), 11)
        part = round_shift(_in_32(stress * self.area[k][None, :, None, None]), 5)
        for corner in CORNERS:
            force = corner[2] * part[:, 0] + corner[1] * part[:, 1] + corner[0] * part[:, 2]
            _corner(load[k if corner[0] > 0 else k + 1], corner)[...] += force
        trace = sum(square[i, i] >> 2 for i in range(3))
        return _in_32(round_shift(trace, 11) * int(self.volume[k]))

    def _waves(self, field: I64) -> tuple[I64, int]:
        f, e = narrow(field)
        along_y = np.stack([self.cos_y @ f[0], self.sin_y @ f[1], self.cos_y @ f[2]])
        t, shift = narrow(_in_32(along_y))
        e += shift - WAVE_FRACTION
        both = np.stack([t[0] @ self.sin_x.T, t[1] @ self.cos_x.T, t[2] @ self.cos_x.T])
        w, shift = narrow(_in_32(both))
        return w, e + shift - WAVE_FRACTION

    def _at_nodes(self, b: I64) -> tuple[I64, int]:
        along_x = np.stack([b[0] @ self.sin_x, b[1] @ self.cos_x, b[2] @ self.cos_x])
        t, shift = narrow(_in_32(along_x))
        both = np.stack([self.cos_y.T @ t[0], self.sin_y.T @ t[1], self.cos_y.T @ t[2]])
        return _in_32(both), shift - 2 * WAVE_FRACTION

    def _mid_waves(self, field: I64) -> tuple[I64, int]:
        f, e = narrow(field)
        t, shift = narrow(_in_32(self.mid_y @ f))
        w, last = narrow(_in_32(t @ self.mid_x.T))
        return w, e + shift + last - 2 * WAVE_FRACTION

    def _at_middles(self, b: I64) -> tuple[I64, int]:
        t, shift = narrow(_in_32(b @ self.mid_x))
        return _in_32(self.mid_y.T @ t), shift - 2 * WAVE_FRACTION


def _corner(plane: I64, corner: tuple[int, int, int]) -> I64:
    y, x = (slice(1, None) if s > 0 else slice(None, -1) for s in corner[1:])
    return plane[:, y, x]
