"""Kind `fingertip` as integers (proto/CALIBRATION.md), and its file."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate.container import CalibrationFile, base_metadata, pack
from ruffini.estimators.fingertip.face import FaceTable, cells, rays
from ruffini.estimators.fingertip.field import kernel, places
from ruffini.estimators.fingertip.fit import GATE_PX, MOST, TO_BOARD, TipFit, tip_radius_mm

Q14, Q16 = 2**14, 2**16
PER_MM = 16_000  # steps of 1/16 um


def _whole(values: npt.ArrayLike) -> npt.NDArray[np.int32]:
    return np.round(np.asarray(values, dtype=float)).astype(np.int32)


def tables(fit: TipFit) -> tuple[dict[str, npt.NDArray[Any]], dict[str, str]]:
    """Tensors and metadata by name."""
    bench, modes, radius = fit.bench, fit.modes, fit.bench.eyes.radius_mm
    nets = [mode.network for mode in modes]
    out = {
        "rest": bench.pins.rest * 256, "normal": bench.pins.normal * Q14,
        "gain": bench.eyes.gains(bench.pins.place) * 1e3 * 256,
        "place": places(radius) * Q14, "kernel": kernel(radius) * 2**15,
        "gate": [GATE_PX * 256, max(bench.touch_mm * PER_MM, 1)],
        "zero": bench.scale.zero * TO_BOARD, "scale": bench.scale.one * TO_BOARD,
        "trust": [np.clip(mode.trust * 256, 1, 2**20) for mode in modes],
        "mean": [net.mean * PER_MM for net in nets],
        "weight0": [net.projection / PER_MM * 2**28 for net in nets],
        "length": [PER_MM / np.linalg.norm(net.projection, axis=1) for net in nets],
        "near": [np.minimum(mode.near * 2**12, 2**26) for mode in modes],
        "limit": [np.minimum(mode.limits * [1, PER_MM], 32_000) for mode in modes],
    }  # fmt: skip
    for layer in range(3):
        out[f"weight{layer + 1}"] = [net.weights[layer] * Q16 for net in nets]
        out[f"bias{layer + 1}"] = [net.biases[layer] * Q16 for net in nets]
    out["rim"] = np.array(fit.report["rim_px"]) * Q16
    if modes[0].face is not None:
        out |= face_tables(modes[0].face, radius, tip_radius_mm(bench))
    most_un = round(MOST * bench.scale.full_n * 1e6)
    return {f"fingertip.{name}": _whole(values) for name, values in out.items()}, {"fingertip.most_un": str(most_un)}


def face_tables(face: FaceTable, radius_mm: float, tip_mm: float) -> dict[str, npt.ArrayLike]:
    """Those of firmware/stages/fingertip/tip_area.h."""
    to_board = np.array([1e6, 1e3, 256, 256])[:, None] * [1, 1, 0] + [0, 0, 1]
    return {
        "ray": rays(radius_mm) * Q14, "cell": cells() * 1e6, "tip": [tip_mm * PER_MM],
        "face_axis": np.maximum(face.axis * to_board, [[-(2**30), 1, 2]]), "face": face.values * [1e3, Q16, Q16],
    }  # fmt: skip


def calibration(board: Board, fit: TipFit) -> CalibrationFile:
    """A file of a fit alone."""
    tensors, metadata = tables(fit)
    return pack(tensors, {**base_metadata(board), **metadata})
