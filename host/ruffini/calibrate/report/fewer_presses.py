"""What fewer presses of a log would have been worth: fits to some of them, judged on the others.

So the report answers how many presses a unit needs, and whether more would help.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.calibrate.container import CalibrationFile
from ruffini.errors import InputError

Numbers = npt.NDArray[np.intp]
Figures = dict[str, float]
Progress = Callable[[float], None]

SIZES = (5, 10, 20, 50, 100)
N_DRAWS, SEED = 3, 1  # of presses, for each number of them
LEAST_JUDGED = 3  # presses that do not belong to a draw
WORDS = {  # of a figure, and by how much it is scaled to be read
    "board": ("force of the others off by {:.1f} mN", 1e3),
    "prior": ("{:.1f} from what was known before", 1e3),
    "error_percent": ("the others off by {:.2f} % of what each axis was loaded with, RMS", 1.0),
    "force_error_percent": ("the others off by {:.1f} % of a force above 2 N, mean", 1.0),
    "place_error_mm": ("place by {:.2f} mm", 1.0),
}


def draws(
    n_presses: int, sizes: tuple[int, ...], n_draws: int, *, is_shuffled: bool
) -> Iterator[tuple[int, Numbers, Numbers]]:
    """Size, what is fitted and what is judged: indices of presses, none in both. The same for the same numbers.

    is_shuffled : else presses that followed each other, from anywhere on: what a shorter plan would have been, as
        plans spread their places, and go through the kinds of loads, as they go.
    """
    rng = np.random.default_rng(SEED)
    for size in (s for s in sizes if s <= n_presses - LEAST_JUDGED):
        for _ in range(n_draws):
            order = (
                rng.permutation(n_presses) if is_shuffled else np.roll(np.arange(n_presses), -rng.integers(n_presses))
            )
            yield size, order[:size], order[size:]


def accuracy_of_presses(
    n_presses: int, error: Callable[[Numbers, Numbers], Figures], progress: Progress = lambda _: None,
    *, sizes: tuple[int, ...] = SIZES, n_draws: int = N_DRAWS, is_shuffled: bool = False,
) -> list[dict[str, Any]]:  # fmt: skip
    """A row for each size: `presses` and the root mean square over the draws of each of `error`'s figures.

    error : of a fit to the first presses on the second. A draw that cannot be fitted is left out; a size of which none
        can has its reason as `why_not`.
    """
    planned = list(draws(n_presses, sizes, n_draws, is_shuffled=is_shuffled))
    found: dict[int, list[Figures]] = {size: [] for size, _, _ in planned}
    reason: dict[int, str] = {}
    for done, (size, used, left) in enumerate(planned, 1):
        try:
            found[size].append(error(used, left))
        except InputError as failure:
            reason[size] = str(failure)
        progress(done / len(planned))
    return [{"presses": size} | (_mean(figures) if figures else {"why_not": reason[size]})
            for size, figures in found.items()]  # fmt: skip


def _mean(figures: list[Figures]) -> Figures:
    return {name: float(np.sqrt(np.mean([f[name] ** 2 for f in figures]))) for name in figures[0]}


def accuracy_in(file: CalibrationFile, stage: str) -> list[dict[str, Any]]:
    """Those rows as the fit that made a file wrote them there; empty where it wrote none."""
    try:
        said = json.loads(file.metadata.get("residuals", "{}"))
        rows = said.get("stages", {}).get(stage, said).get("accuracy_of_presses", [])
    except (ValueError, AttributeError):
        return []
    return rows if isinstance(rows, list) else []


def accuracy_text(row: dict[str, Any]) -> str:
    """One of those rows, to be read by a person."""
    said = ", ".join(WORDS[k][0].format(v * WORDS[k][1]) for k, v in row.items() if k in WORDS)
    return f"{row['presses']:3d} presses: {said or row.get('why_not', 'cannot be fitted')}"
