"""Shards made by this process, by processes of this machine, or by a Dask cluster: (shard, bytes) in any order."""

from __future__ import annotations

from ruffini import workers
from ruffini.sim.dataset.plan import Plan
from ruffini.sim.dataset.shard import make_shard

Results = workers.Results


def _work(plan: Plan) -> workers.Work:
    return workers.Work(make_shard, (plan.model_dump_json(),), f"ruffini-{plan.sha256()[:16]}", "shard")


def in_process(plan: Plan, shards: list[int]) -> Results:
    """One after the other, here."""
    return workers.in_process(_work(plan), shards)


def in_processes(plan: Plan, shards: list[int], n_workers: int) -> Results:
    """In `n_workers` processes of this machine; raises as `workers.in_processes`."""
    return workers.in_processes(_work(plan), shards, n_workers)


def on_dask(plan: Plan, shards: list[int], address: str) -> Results:
    """On the workers of a Dask scheduler; raises as `workers.on_dask`."""
    return workers.on_dask(_work(plan), shards, address)
