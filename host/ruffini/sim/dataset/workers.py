"""Who makes the shards: this process, processes of this machine, or a Dask cluster.

Each yields (shard, bytes) in any order, with a bounded number under way: results that nobody has
written yet take memory.
"""

from __future__ import annotations

import concurrent.futures
import importlib
import multiprocessing
from collections.abc import Iterator
from concurrent.futures.process import BrokenProcessPool
from typing import Any

from ruffini.errors import InputError, RuffiniError
from ruffini.sim.dataset.plan import Plan
from ruffini.sim.dataset.shard import make_shard

Results = Iterator[tuple[int, bytes]]
AHEAD = 2  # shards under way for each worker
CONNECT_TIMEOUT_S = 10


def in_process(plan: Plan, shards: list[int]) -> Results:
    """One after the other, here."""
    for shard in shards:
        yield shard, make_shard(plan.model_dump_json(), shard)


def in_processes(plan: Plan, shards: list[int], n_workers: int) -> Results:
    """In `n_workers` processes of this machine.

    Raises
    ------
    RuffiniError
        A worker process was killed.
    """
    waiting, text = list(reversed(shards)), plan.model_dump_json()
    spawn = multiprocessing.get_context("spawn")  # a fork would copy OpenCV's and BLAS's threads half
    with concurrent.futures.ProcessPoolExecutor(n_workers, mp_context=spawn) as pool:
        under_way: dict[concurrent.futures.Future[bytes], int] = {}
        try:
            while waiting or under_way:
                while waiting and len(under_way) < AHEAD * n_workers:
                    shard = waiting.pop()
                    under_way[pool.submit(make_shard, text, shard)] = shard
                done, _ = concurrent.futures.wait(under_way, return_when=concurrent.futures.FIRST_COMPLETED)
                for future in done:
                    yield under_way.pop(future), future.result()
        except BrokenProcessPool as error:
            raise RuffiniError(
                "a worker process was killed (out of memory?): what is written is whole; "
                "run the same command again, perhaps with fewer --workers"
            ) from error
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def on_dask(plan: Plan, shards: list[int], address: str) -> Results:
    """On the workers of a Dask scheduler; a shard whose worker dies is given to another one.

    Raises
    ------
    InputError
        Dask is not installed, no scheduler answers, or it has no workers.
    RuffiniError
        One shard has killed several workers, or the cluster went away.
    """
    try:
        distributed: Any = importlib.import_module("distributed")
    except ImportError as error:
        raise InputError("--dask needs Dask: pip install 'ruffini[fleet]'") from error
    try:
        client = distributed.Client(address, timeout=CONNECT_TIMEOUT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(f"no Dask scheduler answers at {address}: check --dask ({error})") from error
    waiting, text = list(reversed(shards)), plan.model_dump_json()
    with client:
        try:
            client.wait_for_workers(1, timeout=CONNECT_TIMEOUT_S)
        except TimeoutError as error:
            raise InputError(f"the Dask scheduler at {address} has no workers: start some (`dask worker`)") from error
        n_ahead = AHEAD * max(1, sum(client.ncores().values()))

        def submit(shard: int) -> Any:
            return client.submit(make_shard, text, shard, key=f"ruffini-{plan.sha256()[:16]}-{shard}", pure=False)

        first = [waiting.pop() for _ in range(min(n_ahead, len(waiting)))]
        number = {future.key: (shard, future) for shard in first for future in [submit(shard)]}
        queue = distributed.as_completed([future for _, future in number.values()], loop=client.loop)
        for future in queue:
            shard, _ = number.pop(future.key)
            try:
                data = future.result()
            except distributed.KilledWorker as error:
                raise RuffiniError(f"shard {shard} killed every worker that took it: {error}") from error
            except concurrent.futures.CancelledError as error:
                raise RuffiniError(
                    f"the Dask cluster at {address} went away: what is written is whole; run the same command again"
                ) from error
            future.release()
            if waiting:
                following = waiting.pop()
                new = submit(following)
                number[new.key] = (following, new)
                queue.add(new)
            yield shard, bytes(data)
