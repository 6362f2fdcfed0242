"""What pictures of a fingertip's pins can hold of a tool at all: how far apart two tools' pictures are, in noise.

d = |shift - shift'| / sigma over all coordinates that both eyes see: shifts of the twin's true wall under the pins,
without noise (that tips turn with the wall makes it about 1.6 times as much); sigma from two recordings of one press.
Two tools that are d apart are taken for one another with the probability Phi(-d / 2) by an observer who knows both
pictures by heart. Of a tool that stands at X or at -X nobody errs by less than 2 |X| Phi(-d / 2) on the mean:
`least_mm` is that, over the tests along X that are in pairs.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from papers.recorded import Recorded, shape_of
from ruffini.boards import Board
from ruffini.estimators.fingertip.area import read_nodes
from ruffini.estimators.fingertip.fit import Bench, taken
from ruffini.estimators.fingertip.presses import read_press

Array = npt.NDArray[np.float64]


def told_apart(
    board: Board, bench: Bench, runs: list[Recorded], truth_of: Callable[[Recorded], Array]
) -> dict[str, Any]:
    """Deviations between presses and the disc of 5 mm at X = 0, frame by frame at the same way of the tool: aside, and
    of another size. Runs are of the paper's bench; empty without two of its set test_force.
    """
    middle = [r for r in runs if r.set_name == "test_force"][:2]
    if len(middle) < 2:
        return {}
    first, again = (read_press(board, r.folder) for r in middle)
    pins = bench.pins.rest
    sigma = float((taken(first, pins)[1] - taken(again, pins)[1]).std() / np.sqrt(2))
    home = _shifts(board, bench, middle[0])
    aside = {_number(r, "at_um") * 1e-3: _shifts(board, bench, r) for r in runs if r.set_name == "test_x"}
    sizes = [r for r in runs if r.set_name == "tools" and shape_of(r) == "flat" and _number(r, "radius_um") != 5000]
    others = {f"X = {x:g} mm": shifts for x, shifts in aside.items()}
    others |= {f"radius {_number(r, 'radius_um') / 1e3:g} mm": _shifts(board, bench, r) for r in sizes}
    return {
        "force_n": truth_of(middle[0])[middle[0].touched, 0].tolist(), "noise_px": sigma,
        "deviations": {name: _apart(shifts, home, sigma).tolist() for name, shifts in others.items()},
        "least_mm": least_mm(aside, sigma),
    }  # fmt: skip


def least_mm(aside: dict[float, Array], sigma: float) -> list[float]:
    """Mean over the pairs X, -X of shifts (t, k), frame by frame; empty without any pair."""
    from scipy.special import ndtr

    pairs = [x for x in aside if x > 0 and -x in aside]
    floors = [2 * x * ndtr(-_apart(aside[x], aside[-x], sigma) / 2) for x in pairs]
    return np.mean(floors, axis=0).tolist() if floors else []


def _apart(one: Array, other: Array, sigma: float) -> Array:
    return np.asarray(np.linalg.norm(one - other, axis=1) / sigma)


def _shifts(board: Board, bench: Bench, run: Recorded) -> Array:
    """Where pins are in the frame, px, of each touched frame, (t, 4 n), without noise."""
    place, eyes = bench.pins.place, bench.eyes
    nodes = run.truth["displacement"][run.touched] * 1e3
    moved = [read_nodes(frame, 1e-3 * board.pad.size_x_um, place[:, :2]) for frame in nodes]
    return np.asarray(eyes.project(place + np.array(moved)).reshape(len(nodes), -1))


def _number(recorded: Recorded, name: str) -> float:
    chosen = recorded.run.chosen[name]
    return float(str(chosen[0] if isinstance(chosen, list | tuple) else chosen))
