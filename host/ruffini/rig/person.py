"""The person at the terminal."""

from __future__ import annotations

import os
from collections.abc import Callable

from ruffini.errors import RefusedError
from ruffini.rig.stop_key import stdin

GO_ON = (b"\n", b"\r")


class TerminalPerson:
    """Reads what it is told, and answers with Enter; any other key stops."""

    def __init__(self, say: Callable[[str], None], descriptor: int | None = None) -> None:
        self.say = say
        self._terminal = stdin() if descriptor is None else descriptor

    def confirm(self, text: str) -> None:
        """Ask, and wait for Enter.

        Raises
        ------
        RefusedError
            Another key, or nobody is there.
        """
        self.say(f"{text}, then press Enter (any other key stops)")
        answer = b"" if self._terminal is None else os.read(self._terminal, 1)
        if answer not in GO_ON:
            raise RefusedError(f"stopped {'by a key' if answer else 'because nobody answers'} at {text!r}: what was "
                               "collected is kept, the same command goes on from there")  # fmt: skip
