"""A training that was cut goes on where it was: one file beside its results, written whole after each pass."""

from __future__ import annotations

import io
import pickle
from pathlib import Path
from typing import Any

import torch

from ruffini.errors import InputError
from ruffini.files import write_whole


def keep(path: Path, told: str, state: dict[str, Any]) -> None:
    """Write `state`; `told` says of what training it is."""
    file = io.BytesIO()
    torch.save({**state, "told": told}, file)
    write_whole(path, file.getvalue(), remedy="make room and run the same command again")


def resume(path: Path, told: str, settings: str) -> dict[str, Any] | None:
    """What was kept; None where there is nothing. `settings`: what `told` is made of, for the message.

    Raises
    ------
    InputError
        The file is no checkpoint, or another training's.
    """
    if not path.exists():
        return None
    try:
        state: dict[str, Any] = torch.load(path, weights_only=True)
        belongs_to = state["told"]
    except (OSError, RuntimeError, EOFError, KeyError, TypeError, ValueError, pickle.UnpicklingError) as error:
        raise InputError(f"{path}: no checkpoint of a training: remove it, or choose another --out") from error
    if belongs_to != told:
        raise InputError(
            f"{path} belongs to a training with {settings}: give the same options to go on with it, or choose "
            "another --out"
        )
    return state
