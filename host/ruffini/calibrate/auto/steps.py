"""The steps of a run of `cal auto`, and how long each took."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from ruffini.files import write_whole


class Steps:
    """Times of the steps, kept in `folder`. With `goes_on`, a run that was stopped goes on counting."""

    def __init__(self, folder: Path, say: Callable[[str], None], *, goes_on: bool = True) -> None:
        self._known, self._say = folder / "seconds.json", say
        is_begun = goes_on and self._known.exists()
        self.seconds: dict[str, float] = json.loads(self._known.read_text()) if is_begun else {}

    @contextlib.contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """A step of this name."""
        start = time.monotonic()
        self._say(f"{name} ...")
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.monotonic() - start
        write_whole(self._known, json.dumps(self.seconds).encode())
        self._say(f"{name}: {self.seconds[name]:.0f} s")
