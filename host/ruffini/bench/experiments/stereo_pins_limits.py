"""What pictures of a fingertip's pins can hold of a tool at all: how far apart two tools' pictures are, in noise.

d^2 = sum |shift - shift'|^2 / sigma^2 - 2 n over all n coordinates that both eyes see; sigma from two recordings of the
same press. Two tools that are d deviations apart are told apart with an error of about their difference over d, by an
estimator that knew everything else. What is nearer than LEAST is counted as alike. Where X, -X and 0 are alike, nobody
errs by less than |X| on the mean of the two: `least_mm` is the mean of that over the tests along X, which are in pairs.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.bench.papers.recorded import Recorded, shape_of
from ruffini.boards import Board
from ruffini.calibrate.fingertip import taken
from ruffini.calibrate.tip_presses import Press, read_press

Array = npt.NDArray[np.float64]

LEAST = 17.0  # d^2 of noise alone has a deviation of sqrt(8 n), n = 1,168: three of them


def told_apart(board: Board, runs: list[Recorded], truth_of: Callable[[Recorded], Array]) -> dict[str, Any]:
    """Deviations between presses and the disc of 5 mm at X = 0, frame by frame at the same way of the tool: aside, and
    of another size. Runs are of the paper's bench; empty without two of its set test_force.
    """
    middle = [r for r in runs if r.set_name == "test_force"][:2]
    if len(middle) < 2:
        return {}
    first, again = (read_press(board, r.folder) for r in middle)
    touched = np.isfinite(first.told[:, 0])
    variance = ((_apart(first, again)[touched]) ** 2).mean() / 2
    others = {f"X = {_number(r, 'at_um') / 1e3:g} mm": r for r in runs if r.set_name == "test_x"}
    sizes = [r for r in runs if r.set_name == "tools" and shape_of(r) == "flat"]
    others |= {f"radius {_number(r, 'radius_um') / 1e3:g} mm": r for r in sizes if _number(r, "radius_um") != 5000}
    out: dict[str, Any] = {
        "force_n": truth_of(middle[0])[middle[0].touched, 0].tolist(),
        "noise_px": float(np.sqrt(variance)), "deviations": {}, "least_mm": [],
    }  # fmt: skip
    least = []
    for name, press in [
        ("the same again", again),
        *((name, read_press(board, r.folder)) for name, r in others.items()),
    ]:
        squares = (_apart(first, press)[touched] ** 2).reshape(int(touched.sum()), -1)
        beyond = np.sqrt(np.maximum(squares.sum(axis=1) / variance - 2 * squares.shape[1], 0))
        is_alike = beyond < LEAST
        out["deviations"][name] = np.where(is_alike, 0.0, beyond).tolist()
        if name.startswith("X"):
            least.append(is_alike * abs(_number(others[name], "at_um")) * 1e-3)
    out["least_mm"] = np.mean(least, axis=0).tolist() if least else []
    return out


def _apart(first: Press, other: Press) -> Array:
    """Shifts of another press's pins less those of the first, (t, 2, n, 2) px."""
    return np.asarray(taken(other, first.rest)[1] - first.moved)


def _number(recorded: Recorded, name: str) -> float:
    chosen = recorded.run.chosen[name]
    return float(str(chosen[0] if isinstance(chosen, list | tuple) else chosen))
