"""What flashing and a writer's lease need of an open sensor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from ruffini.wire import Schema

DEVICE = 255  # the sensor id of messages that concern the whole device


class Line(Protocol):
    """Commands and replies on a line that may be lost and opened again; Connection is one."""

    port: str
    hello: Any
    schema: Schema
    n_retries: int

    def command(self, *, waits_s: Sequence[float] = ..., **action: Any) -> Any: ...

    def checked(self, **action: Any) -> Any: ...

    def refresh_hello(self) -> None: ...

    def resume(self, timeout_s: float) -> None: ...
