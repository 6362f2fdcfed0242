"""Old, moved and altered pictures of a camera, through the core."""

from __future__ import annotations

from collections.abc import Iterator

from row import Row


def rows(seed: int, quick: bool) -> Iterator[Row]:
    """Nothing yet."""
    del seed, quick
    yield from ()
