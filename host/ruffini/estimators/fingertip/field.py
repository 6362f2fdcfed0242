"""The field of displacement about the touched place of a fingertip: firmware/stages/fingertip/tip_field.h in floats.

What a calibration is fitted on; the firmware computes the same in integers, to 1/16 um. Millimetres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

REACH_MM, STEP_MM = 13.0, 2.2  # places of the field, along the surface from the touched one
KERNEL_MM = 1.4
KERNEL_STEPS = 2048  # of the squared distance on the unit sphere, each 2^-15
KERNEL_FLOOR = int(2**15 / 20) / 2**15
PRESS_PART = 77 / 256
PLACE_MM = 0.5  # weight of the touched place among the features


def places(radius_mm: float) -> Array:
    """Directions (g, 3) of a hexagonal lattice about the top."""
    reach = int(REACH_MM / STEP_MM) + 2
    i, j = (a.ravel() for a in np.meshgrid(np.arange(-reach, reach + 1), np.arange(-reach, reach + 1)))
    at = STEP_MM * np.stack([i + j / 2, np.sqrt(3) / 2 * j], axis=1)
    way = np.linalg.norm(at, axis=1)
    at, way = at[way <= REACH_MM], way[way <= REACH_MM]
    angle = way / radius_mm
    sideways = at * (np.sin(angle) / np.maximum(way, 1e-9))[:, None]
    return np.column_stack([sideways, np.cos(angle)])


def kernel(radius_mm: float) -> Array:
    """K at the middle of each step of the squared distance, (KERNEL_STEPS,)."""
    away2 = (np.arange(KERNEL_STEPS) + 0.5) / 2**15 * radius_mm**2
    return np.asarray(np.exp(-away2 / (2 * KERNEL_MM**2)))


@dataclass(frozen=True)
class Field:
    """Features (t, 3 g + 2) mm of frames, and R of each, (t, 3, 3)."""

    features: Array
    turn: Array


def turn_to_top(middle: Array) -> Array:
    """The short way from directions (t, 3) to (0, 0, 1), (t, 3, 3)."""
    x, y, z = middle.T
    part = 1 / (1 + z)
    rows = [1 - x * x * part, -x * y * part, -x, -x * y * part, 1 - y * y * part, -y, x, y, z]
    return np.stack(rows, axis=1).reshape(-1, 3, 3)


def pressed(moved: Array, normal: Array) -> Array:
    """How far pins moved inwards, (t, n), from displacements (t, n, 3)."""
    return np.asarray(-np.einsum("tnc,nc->tn", moved, normal))


def field_of(moved: Array, normal: Array, radius_mm: float) -> Field:
    """From displacements (t, n, 3) of pins with outward normals (n, 3)."""
    inward = pressed(moved, normal)
    weight = np.maximum(inward - PRESS_PART * inward.max(axis=1, keepdims=True), 0)
    middle = weight @ normal
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    turn, at, table = turn_to_top(middle), places(radius_mm), kernel(radius_mm)
    out = np.zeros((len(moved), 3 * len(at) + 2))
    for t in range(len(moved)):
        away2 = 2 - 2 * at @ (normal @ turn[t].T).T
        step = np.maximum(away2 * 2**15, 0).astype(np.int64)
        k = np.where(step < KERNEL_STEPS, table[np.minimum(step, KERNEL_STEPS - 1)], 0.0)
        out[t, :-2] = ((k @ (moved[t] @ turn[t].T)) / (k.sum(axis=1, keepdims=True) + KERNEL_FLOOR)).ravel()
    out[:, -2:] = PLACE_MM * middle[:, :2]
    return Field(out, turn)
