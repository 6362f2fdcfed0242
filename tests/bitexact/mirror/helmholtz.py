"""A flow's curl-free part, what is left, and how far the object has turned (firmware/stages/helmholtz/helmholtz.h)."""

from __future__ import annotations

from math import isqrt

import numpy as np

from mirror.board import Board
from mirror.fixed import I64, Saturations, round_shift
from mirror.poisson import cos_pi_q30, scaled, type_ii, type_iii


def _sine_square(n: int) -> I64:
    """sin^2(pi k / n), Q30."""
    sine = cos_pi_q30(np.abs(n - 2 * np.arange(n, dtype=np.int64)), 2 * n)
    return round_shift(sine * sine, 30)


def _fit(wide: I64) -> tuple[I64, int]:
    """Times a power of two that leaves the transforms room, and its exponent."""
    largest = int(np.abs(wide).max())
    shift = 29 - largest.bit_length() - wide.size.bit_length() if largest else 0
    return scaled(wide, shift), shift


class Helmholtz:
    """From the flow of ContactProfile, 1/16 um."""

    def __init__(self, board: Board) -> None:
        m = board["markers"]
        self._pitch = m["pitch_x_um"], m["pitch_y_um"]
        n_x, n_y = m["n_x"], m["n_y"]
        twice = [2 * m[f"first_{a}_um"] - board["pad"][f"size_{a}_um"] for a in "xy"]
        places = (t + 2 * p * np.arange(1, n - 1) for t, p, n in zip(twice, self._pitch, (n_x, n_y), strict=True))
        self._twice_x, self._twice_y = places
        self._rho = (2 * (self._pitch[0] << 14) + self._pitch[1]) // (2 * self._pitch[1])
        along_y = round_shift(round_shift(_sine_square(n_y), 2) * self._rho**2, 26)
        wave = _sine_square(n_x)[None, :] + along_y[:, None]
        weight = np.full((n_y, n_x), 4, np.int64)
        weight[0] //= 2
        weight[:, 0] //= 2
        wave[0, 0] = 1
        self._factor = (weight << 57) // (wave * (n_x * n_y))
        self._factor[0, 0] = 0

    def run(self, flow: I64, middle: tuple[int, int], saturations: Saturations) -> tuple[I64, list[int]]:
        """(n_y, n_x, 2) of the curl-free part, and the sums in the order of the C interface."""
        u = saturations.clamp(flow, -(1 << 18), 1 << 18)
        plane, up = _fit(self._divergence(u))
        waves = type_ii(type_ii(plane).T.copy()).T
        plane, up_again = _fit(-waves * self._factor)
        phi = type_iii(type_iii(plane).T.copy()).T
        scale = -(up + 28 + up_again) - 1
        edged = np.pad(phi, 1, mode="edge")
        along_x, along_y = edged[1:-1, 2:] - edged[1:-1, :-2], edged[2:, 1:-1] - edged[:-2, 1:-1]
        gradient = np.stack([scaled(along_x, scale), scaled(round_shift(along_y * self._rho, 14), scale)], axis=-1)
        size = sum(isqrt(x * x + y * y) for x, y in gradient.reshape(-1, 2).tolist()) // phi.size
        rest = (u - gradient).reshape(-1, 2).sum(axis=0).tolist()
        return gradient, [size, isqrt(rest[0] ** 2 + rest[1] ** 2) // phi.size, self._twist(u, middle)]

    def _divergence(self, u: I64) -> I64:
        edged = np.pad(u, ((1, 1), (1, 1), (0, 0)), mode="edge")
        along_x = edged[1:-1, 2:, 0] - edged[1:-1, :-2, 0]
        along_y = edged[2:, 1:-1, 1] - edged[:-2, 1:-1, 1]
        along_x[:, [0, -1]] *= 2
        along_y[[0, -1]] *= 2
        return along_x + round_shift(along_y * self._rho, 14)

    def _twist(self, u: I64, middle: tuple[int, int]) -> int:
        away_x, away_y = self._twice_x - 2 * middle[0], self._twice_y - 2 * middle[1]
        inside = away_x[None, :] ** 2 + away_y[:, None] ** 2 <= (4 * self._pitch[0]) ** 2
        n = int(inside.sum())
        if n == 0:
            return 0
        y_along_x = int((u[1:-1, 2:, 1] - u[1:-1, :-2, 1])[inside].sum())
        x_along_y = int((u[2:, 1:-1, 0] - u[:-2, 1:-1, 0])[inside].sum())
        return y_along_x * 10**6 // (64 * self._pitch[0] * n) - x_along_y * 10**6 // (64 * self._pitch[1] * n)
