"""Who does many pieces of work: this process, processes of this machine, or a Dask cluster.

Each yields (item, result) in any order, with a bounded number under way: results that nobody has taken yet need memory.
"""

from __future__ import annotations

import concurrent.futures
import importlib
import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Any

from ruffini.errors import InputError, RuffiniError
from ruffini.extras import missing

Results = Iterator[tuple[int, Any]]
AHEAD = 2  # pieces under way for each worker
CONNECT_TIMEOUT_S = 10


@dataclass(frozen=True)
class Work:
    """`function(*shared, item)` for items that are numbers; `name` is the same for the same work."""

    function: Callable[..., Any]
    shared: tuple[Any, ...]
    name: str
    what: str = "piece"  # an item, in messages


def each(work: Work, items: Sequence[int], *, n_workers: int = 1, dask: str | None = None) -> Results:
    """In this process, in `n_workers` of this machine, or on a Dask scheduler's."""
    if dask is not None:
        return on_dask(work, items, dask)
    return in_processes(work, items, n_workers) if n_workers > 1 else in_process(work, items)


def in_process(work: Work, items: Sequence[int]) -> Results:
    """One after the other, here."""
    for item in items:
        yield item, work.function(*work.shared, item)


def in_processes(work: Work, items: Sequence[int], n_workers: int) -> Results:
    """In `n_workers` processes of this machine.

    Raises
    ------
    RuffiniError
        A worker process was killed.
    """
    waiting = list(reversed(items))
    spawn = multiprocessing.get_context("spawn")  # a fork would copy OpenCV's and BLAS's threads half
    with concurrent.futures.ProcessPoolExecutor(n_workers, mp_context=spawn) as pool:
        under_way: dict[concurrent.futures.Future[Any], int] = {}
        try:
            while waiting or under_way:
                while waiting and len(under_way) < AHEAD * n_workers:
                    item = waiting.pop()
                    under_way[pool.submit(work.function, *work.shared, item)] = item
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


def on_dask(work: Work, items: Sequence[int], address: str) -> Results:
    """On the workers of a Dask scheduler; a piece whose worker dies is given to another one.

    Raises
    ------
    InputError
        Dask is not installed, no scheduler answers, or it has no workers.
    RuffiniError
        One piece has killed several workers, or the cluster went away.
    """
    try:
        asyncio: Any = importlib.import_module("asyncio")  # late: it takes 30 ms
        distributed: Any = importlib.import_module("distributed")
    except ImportError as error:
        raise missing("--dask", "fleet") from error
    try:
        client = distributed.Client(address, timeout=CONNECT_TIMEOUT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(f"no Dask scheduler answers at {address}: check --dask ({error})") from error
    waiting = list(reversed(items))
    with client:
        try:
            client.wait_for_workers(1, timeout=CONNECT_TIMEOUT_S)
        except (TimeoutError, asyncio.TimeoutError) as error:  # two classes in Python 3.10
            raise InputError(f"the Dask scheduler at {address} has no workers: start some (`dask worker`)") from error
        n_ahead = AHEAD * max(1, sum(client.ncores().values()))

        def submit(item: int) -> Any:
            return client.submit(work.function, *work.shared, item, key=f"{work.name}-{item}", pure=False)

        first = [waiting.pop() for _ in range(min(n_ahead, len(waiting)))]
        number = {future.key: (item, future) for item in first for future in [submit(item)]}
        queue = distributed.as_completed([future for _, future in number.values()], loop=client.loop)
        for future in queue:
            item, _ = number.pop(future.key)
            try:
                result = future.result()
            except distributed.KilledWorker as error:
                raise RuffiniError(f"{work.what} {item} killed every worker that took it: {error}") from error
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
            yield item, result
