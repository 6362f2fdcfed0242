"""Gel depth where nothing is fitted that only a simulation knows: the log as a bench would have it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from ruffini.boards import Board
from ruffini.estimators.contact_model.fit import Log, fit_model, seen_of, tell, true_sizes
from ruffini.estimators.contact_model.log import Press, read_press

JUDGED = ("test", "repeat")


def by_bench(board: Board, presses: list[Press], folder: Path) -> dict[str, float]:
    """RMSE, mm, of gel and press depth by set of the paper's bench, against the twin; and of hardness on its test."""
    model = fit_model(board, Log.of(board, [p.of_bench() for p in presses]), n_seeds=1)
    out: dict[str, float] = {}
    for name in JUDGED:
        judged = [
            read_press(card.parent, json.loads(card.read_text()), board)
            for card in sorted((folder / name).glob("*/run.json"))
        ]
        errors, shore = [], []
        for press in judged:
            seen = seen_of(press, -model.wrench(press.flow)[:, 2])
            errors.append(model.sizes(seen) - true_sizes(press)[seen.frame])
            said = tell(press, model)
            if said.is_told and press.has_model:
                shore.append(said.shore[int(press.is_hertzian)] - press.shore_a)
        if not judged:
            continue
        gel, travel = np.sqrt(np.nanmean(np.concatenate(errors)[:, :2] ** 2, axis=0))
        out |= {f"{name}, gel": float(gel), f"{name}, press": float(travel)}
        if shore:
            out[f"{name}, Shore A, told the kind"] = float(np.sqrt(np.mean(np.square(shore))))
    return out
