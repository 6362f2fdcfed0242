"""The shear that a contact mostly carries: firmware/solve/shear_modes.h."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.ndimage

from mirror.block_float import common_shift, in_16_bits, ratio, scaled, shifted, squares
from mirror.board import Board, observed_nodes
from mirror.fixed import I64

MAX_CONTACTS = 8
GAIN_SHIFT = 1
NOISE_SHARE = 192
FULL = 128
LEAST_SHARE = 32


def node_places(board: Board) -> list[tuple[int, int]]:
    """Micrometres from the pad's centre, half up."""

    def line(axis: str) -> list[int]:
        steps = board["grid"][f"n_{axis}"] - 1
        size = board["pad"][f"size_{axis}_um"]
        return [((2 * i - steps) * size + steps) // (2 * steps) for i in observed_nodes(board, axis)]

    return [(x, y) for y in line("y") for x in line("x")]


@dataclass
class Contact:
    positions: list[int]  # among the support's nodes
    modes: list[list[int]]  # x, y of each node
    norms: list[int]

    def shear(self, values: list[int]) -> list[int]:
        return [values[3 * k + c] for k in self.positions for c in (0, 1)]


def find_contacts(mask: I64, nodes: list[int]) -> list[Contact]:
    """The first contacts of a mask; `nodes` are the support's."""
    label, n = scipy.ndimage.label(mask > 0, structure=np.ones((3, 3)))
    flat = label.ravel()
    return [
        Contact([k for k, node in enumerate(nodes) if flat[node] == c], [], [])
        for c in range(1, min(n, MAX_CONTACTS) + 1)
    ]


def _take_out(mode: list[int], norm: int, values: list[int]) -> list[int]:
    dot = _dot(mode, values)
    if dot == 0:
        return values
    part, sign = ratio(abs(dot), norm, 0), 1 if dot > 0 else -1
    return [v - sign * scaled(b, part, 0) for v, b in zip(values, mode, strict=True)]


def _dot(a: list[int], b: list[int]) -> int:
    dot = sum(x * y for x, y in zip(a, b, strict=True))
    assert abs(dot) < 1 << 62
    return dot


def learn(contact: Contact, y: list[int], weight: list[int], places: list[tuple[int, int]]) -> None:
    """The modes of the estimate y; `places` of the support's nodes."""
    contact.modes, contact.norms = [], []
    pressure = in_16_bits([max(-y[3 * k + 2], 0) for k in contact.positions])
    total = sum(pressure)
    if total == 0:
        return
    at = [places[k] for k in contact.positions]
    center = [sum(p * xy[c] for p, xy in zip(pressure, at, strict=True)) // total for c in (0, 1)]
    x_y = [(xy[0] - center[0], xy[1] - center[1]) for xy in at]
    far = in_16_bits([x * x + y_ * y_ for x, y_ in x_y])
    bulge = [p * f for p, f in zip(pressure, far, strict=True)]
    for amplitude in (pressure, [weight[3 * k] for k in contact.positions], bulge):
        for direction in range(4):
            vector: list[int] = []
            for a, (x, y_) in zip(amplitude, x_y, strict=True):
                along = ((1, 0), (0, 1), (-y_, x), (x, y_))[direction]
                vector += [a * along[0], a * along[1]]
            _append(contact, in_16_bits(vector))


def _append(contact: Contact, vector: list[int]) -> None:
    before = squares(vector, 0)
    vector = [v << 8 for v in vector]
    for mode, norm in zip(contact.modes, contact.norms, strict=True):
        vector = _take_out(mode, norm, vector)
    if before == 0 or squares(vector, 8) * LEAST_SHARE < before:
        return
    contact.modes.append(in_16_bits(vector))
    contact.norms.append(squares(contact.modes[-1], 0))


def shrink(contact: Contact, y: list[int], weight: list[int], noise_y: int) -> None:
    """Takes off `y` what of its shear no mode explains and noise does."""
    left = contact.shear(y)
    for mode, norm in zip(contact.modes, contact.norms, strict=True):
        left = _take_out(mode, norm, left)
    shift = common_shift(left)
    energy = squares(left, shift)
    if energy == 0:
        return
    weights = sum(2 * weight[3 * k] ** 2 for k in contact.positions) >> 14
    noise = shifted(noise_y**2 * weights, 2 * shift)
    lost = FULL if noise >= energy else min(NOISE_SHARE * noise // energy, FULL)
    for i, k in enumerate(contact.positions):
        for c in (0, 1):
            y[3 * k + c] -= (left[2 * i + c] * lost + 64) >> 7


def precondition(contacts: list[Contact], r: list[int], z: list[int], energy_shift: int) -> int:
    """Adds to z; r . (what it added) in units of 2^(2 energy_shift)."""
    energy = 0
    for contact in contacts:
        for mode, norm in zip(contact.modes, contact.norms, strict=True):
            dot = _dot(mode, contact.shear(r))
            if dot == 0:
                continue
            part, sign = ratio(abs(dot), norm, GAIN_SHIFT), 1 if dot > 0 else -1
            for i, k in enumerate(contact.positions):
                for c in (0, 1):
                    z[3 * k + c] += sign * scaled(mode[2 * i + c], part, 0)
            down = max(abs(dot).bit_length() - 38, 0)
            energy += min(scaled(abs(dot) >> down, part, down - 2 * energy_shift), 1 << 54)
    return energy
