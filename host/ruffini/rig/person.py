"""The person at the terminal or at the page."""

from __future__ import annotations

import contextlib
import os
import re
import select
from collections.abc import Callable

from ruffini.errors import RefusedError
from ruffini.rig.stop_key import stdin

GO_ON = (b"\n", b"\r")
STOP = b"q"
BACKSPACE = (b"\x7f", b"\x08")
WATCH_S = 0.2  # real
MAX_TYPED = 20  # characters of a number
NO_KEY = re.compile(r"[^0-9.,+\- a-pr-z]")  # of a page's text: no q, which stops


def _stopped(answer: bytes, text: str) -> RefusedError:
    return RefusedError(f"stopped {'by a key' if answer else 'because nobody answers'} at {text!r}: what was "
                        "collected is kept, the same command goes on from there")  # fmt: skip


class PageKeys:
    """Key presses from a page, as at a terminal: Enter continues, any other key stops."""

    def __init__(self) -> None:
        self.descriptor, self._write = os.pipe()
        os.set_blocking(self.descriptor, False)
        os.set_blocking(self._write, False)

    def press(self, *, is_stop: bool, typed: str = "") -> None:
        """From any thread. Thousands that nobody has looked at are enough: what comes after them is lost."""
        keys = NO_KEY.sub("?", typed[:MAX_TYPED]).encode() + GO_ON[0]
        with contextlib.suppress(BlockingIOError):
            os.write(self._write, STOP if is_stop else keys)

    def guard(self) -> None:
        """Forget what was pressed so far. Raises RefusedError where a stop was among it."""
        pressed = b""
        while select.select([self.descriptor], [], [], 0)[0]:
            pressed += os.read(self.descriptor, 4096)
        if STOP in pressed:
            raise RefusedError("stopped from the page: what was collected is kept, the same command goes on from there")

    def close(self) -> None:
        os.close(self.descriptor)
        os.close(self._write)


class TerminalPerson:
    """Shows instructions and waits for Enter; any other key stops. A page may answer too.

    watch : called every `WATCH_S` while an answer is awaited; may raise to end that.
    """

    def __init__(
        self, say: Callable[[str], None], descriptor: int | None = None, page: PageKeys | None = None,
        watch: Callable[[], None] = lambda: None,
    ) -> None:  # fmt: skip
        self.say, self._watch = say, watch
        self._keyboards = [stdin() if descriptor is None else descriptor, page.descriptor if page else None]

    def confirm(self, text: str) -> None:
        """Ask, and wait for Enter.

        Raises
        ------
        RefusedError
            Another key, or nobody is there.
        """
        self.say(f"{text}, then press Enter (any other key stops)")
        answer = self._answer()
        if answer not in GO_ON:
            raise _stopped(answer, text)

    def number(self, text: str) -> str:
        """Ask for a number, and wait until it is typed and Enter pressed; returns what was typed, unchecked.

        Raises
        ------
        RefusedError
            The key q, or nobody is there.
        """
        self.say(f"{text}, then press Enter (q stops)")
        typed = b""
        while (key := self._answer()) not in GO_ON:
            if key in (b"", STOP):
                raise _stopped(key, text)
            typed = typed[:-1] if key in BACKSPACE else typed + key if len(typed) < MAX_TYPED else typed
            self._show(typed)
        return typed.decode("ascii", "replace")

    def _show(self, typed: bytes) -> None:
        """What was typed so far: a terminal whose keys are stop keys echoes none."""
        if self._keyboards[0] is not None and os.isatty(self._keyboards[0]):
            os.write(self._keyboards[0], b"\r\x1b[K" + typed)

    def _answer(self) -> bytes:
        """One key, from wherever it comes; none where all keyboards have ended."""
        keyboards = [d for d in self._keyboards if d is not None]
        while keyboards:
            self._watch()
            for keyboard in select.select(keyboards, [], [], WATCH_S)[0]:
                if key := os.read(keyboard, 1):
                    return key
                keyboards.remove(keyboard)
        return b""
