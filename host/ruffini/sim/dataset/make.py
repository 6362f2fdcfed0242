"""Make a dataset, or go on with one: shards that are there are kept, missing ones are made.

plan.json            what it is; another plan is refused
shard-00000.h5 ...   samples (`dataset.shard`), each file whole or not there
README.md            the card, once all shards are there
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ruffini.errors import InputError
from ruffini.files import LOCK_FILE, only_writer, write_whole
from ruffini.sim.dataset import workers
from ruffini.sim.dataset.card import card, shard_name
from ruffini.sim.dataset.plan import PLAN_FILE, Plan, stored_plan
from ruffini.sim.dataset.shard import is_whole
from ruffini.sim.units import build_unit

REMEDY = "make room and run the same command again: it goes on from here"


@dataclass(frozen=True)
class Outcome:
    """What a run did: shards made and kept, samples made, seconds that making took."""

    n_made: int
    n_kept: int
    n_samples_made: int
    took_s: float


def make_dataset(
    plan: Plan,
    folder: Path,
    *,
    n_workers: int = 1,
    dask: str | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> Outcome:
    """Make all shards of a plan that are not there yet, then the card.

    Raises
    ------
    InputError
        The folder holds something else, another run writes there, or it cannot be written.
    RuffiniError
        A sample cannot be made or a worker was killed. What is written stays valid.
    """
    with only_writer(folder):
        _begin(plan, folder)
        todo = [k for k in range(plan.n_shards) if not is_whole(folder / shard_name(k), plan, k)]
        n_samples, start = 0, time.monotonic()
        progress(1 - len(todo) / plan.n_shards)
        for count, (shard, data) in enumerate(_results(plan, todo, n_workers, dask)):
            write_whole(folder / shard_name(shard), data, remedy=REMEDY)
            n_samples += len(plan.indices(shard))
            progress(1 - (len(todo) - count - 1) / plan.n_shards)
        took_s = time.monotonic() - start
        write_whole(folder / "README.md", card(plan, folder).encode(), remedy=REMEDY)
    return Outcome(len(todo), plan.n_shards - len(todo), n_samples, took_s)


def _results(plan: Plan, todo: list[int], n_workers: int, dask: str | None) -> workers.Results:
    if not todo:
        return iter(())
    if dask is not None:
        return workers.on_dask(plan, todo, dask)
    build_unit(plan.board(), plan.error(), twin=plan.twin())  # once, into the cache that the workers share
    if min(n_workers, len(todo)) > 1:
        return workers.in_processes(plan, todo, n_workers)
    return workers.in_process(plan, todo)


def _begin(plan: Plan, folder: Path) -> None:
    stored = stored_plan(folder)
    if stored is None:
        strangers = [path.name for path in folder.iterdir() if path.name != LOCK_FILE]
        if strangers:
            raise InputError(f"{folder} holds {strangers[0]} and no dataset: choose another --out")
        write_whole(folder / PLAN_FILE, plan.model_dump_json().encode(), remedy=REMEDY)
    elif stored != plan:
        other = [key for key in Plan.model_fields if getattr(stored, key) != getattr(plan, key)]
        raise InputError(
            f"{folder} holds a dataset with another {', '.join(other)}: give the same options to go on with it, "
            "or choose another --out"
        )
