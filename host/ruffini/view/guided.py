"""The viewer's page beside a collection: where to press next, how hard, and how good what comes is."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from ruffini.device import Connection
from ruffini.rig.bench import Bench, Person
from ruffini.rig.guide import Guide
from ruffini.rig.guide_view import HeardPerson, told
from ruffini.rig.person import PageKeys
from ruffini.rig.stage import Guard
from ruffini.view.lent_line import LentLine
from ruffini.view.line import Line
from ruffini.view.server import serve

AGAIN = "Run the same command again: it goes on from there."


class GuidingPage:
    """A page that guides a person through a collection.

    Parameters
    ----------
    program : what is collected, in a few words.
    next_step : what to do once it is complete.
    http_port : of this computer; 0 = any that is free.
    ready : gets the address.
    """

    def __init__(self, program: str, next_step: str, http_port: int, ready: Callable[[str], None]) -> None:
        self.guide, self.keys = Guide(), PageKeys()
        self._program, self._next, self._http_port, self._ready = program, next_step, http_port, ready
        self._bench: Bench | None = None
        self._end: dict[str, Any] | None = None

    def heard(self, person: Person) -> Person:
        """The same person, whose page shows what they are told."""
        return HeardPerson(person, self.guide, self.keys.guard)

    def guard(self, other: Guard) -> Guard:
        """Likewise the page's Stop."""

        def both() -> None:
            other()
            self.keys.guard()

        return both

    def look_at(self, bench: Bench) -> None:
        """From now on it shows how this bench fares."""
        bench.guide, self._bench = self.guide, bench

    @contextlib.contextmanager
    def shown(self, sensor: Connection) -> Iterator[None]:
        """Served until the collection inside ends, however it does.

        Raises
        ------
        InputError
            The HTTP port is taken.
        """
        line = LentLine(sensor, self._state, self._hear)
        try:
            with serving([line], self._http_port, self._ready):
                try:
                    yield
                except BaseException as error:
                    self._end = {"ok": False, "text": str(error) or "It was stopped.", "next": AGAIN}
                    raise
                else:
                    self._end = {"ok": True, "text": "All touches are collected.", "next": self._next}
        finally:
            self.keys.close()

    def _state(self) -> dict[str, Any]:
        return {"program": self._program, **told(self.guide, self._bench), "end": self._end}

    def _hear(self, word: str, number: int, typed: str) -> None:
        press_keys(self.keys, self.guide, word, number, typed)


def press_keys(keys: PageKeys, guide: Guide, word: str, number: int, typed: str) -> None:
    """A page's answer; one to a question of before, or a second one to this, is none."""
    if word == "stop":
        keys.press(is_stop=True)
    elif guide.is_asked and number == guide.n_asked:
        guide.is_asked = False
        keys.press(is_stop=False, typed=typed if guide.wants_number else "")


@contextlib.contextmanager
def serving(lines: Sequence[Line], http_port: int, ready: Callable[[str], None]) -> Iterator[None]:
    """`serve` in a thread of its own; raises what it raises."""
    loop, stop, is_ready = asyncio.new_event_loop(), asyncio.Event(), threading.Event()
    problems: list[BaseException] = []
    addresses: list[str] = []

    def say(address: str) -> None:
        addresses.append(address)
        is_ready.set()

    def run() -> None:
        try:
            loop.run_until_complete(serve(lines, http_port, say, stop))
        except BaseException as error:
            problems.append(error)
        finally:
            is_ready.set()
            loop.close()

    thread = threading.Thread(target=run, name="page", daemon=True)
    thread.start()
    is_ready.wait()
    try:
        if addresses:
            ready(addresses[0])
            yield
    finally:
        with contextlib.suppress(RuntimeError):  # it has ended itself
            loop.call_soon_threadsafe(stop.set)
        thread.join()
    if problems:
        raise problems[0]
