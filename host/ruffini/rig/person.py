"""The person at the terminal or at the page."""

from __future__ import annotations

import contextlib
import os
import select
from collections.abc import Callable

from ruffini.errors import RefusedError
from ruffini.rig.stop_key import stdin

GO_ON = (b"\n", b"\r")
STOP = b"q"


class PageKeys:
    """Key presses from a page, as at a terminal: Enter continues, any other key stops."""

    def __init__(self) -> None:
        self.descriptor, self._write = os.pipe()
        os.set_blocking(self.descriptor, False)
        os.set_blocking(self._write, False)

    def press(self, *, is_stop: bool) -> None:
        """From any thread. Thousands that nobody has looked at are enough: what comes after them is lost."""
        with contextlib.suppress(BlockingIOError):
            os.write(self._write, STOP if is_stop else GO_ON[0])

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
    """Shows instructions and waits for Enter; any other key stops. A page may answer too."""

    def __init__(self, say: Callable[[str], None], descriptor: int | None = None, page: PageKeys | None = None) -> None:
        self.say = say
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
            raise RefusedError(f"stopped {'by a key' if answer else 'because nobody answers'} at {text!r}: what was "
                               "collected is kept, the same command goes on from there")  # fmt: skip

    def _answer(self) -> bytes:
        """One key, from wherever it comes; none where all keyboards have ended."""
        keyboards = [d for d in self._keyboards if d is not None]
        while keyboards:
            for keyboard in select.select(keyboards, [], [])[0]:
                if key := os.read(keyboard, 1):
                    return key
                keyboards.remove(keyboard)
        return b""
