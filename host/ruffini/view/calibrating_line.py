"""A serial port that all pages share, and from whose page a person may calibrate the sensor."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ruffini.device import Connection
from ruffini.view.calibration import Calibration
from ruffini.view.lent_line import Refusal, StandIn, answer_in, show_guide, show_guide_always
from ruffini.view.line import SharedLine
from ruffini.view.outbox import Outbox
from ruffini.wire import Frame, Schema

HANDED_OVER = "the sensor is being handed over, to a calibration or back: try again in a second"


class CalibratingLine(SharedLine):
    """The port belongs to the pages, and to the calibration while that presses, flashes or undoes: pages look on then.

    Parameters
    ----------
    folder : where the presses and files of this unit are kept; None: found by board and serial number.
    """

    calibrates = True

    def __init__(self, port: str, folder: Path | None = None) -> None:
        super().__init__(port)
        self.calibration = Calibration(self._borrowed, folder)
        self._stand_in: Refusal | None = None  # None: the port belongs to the pages
        self._is_over = False
        self._task: asyncio.Task[None] | None = None

    async def start(self) -> None:
        await super().start()
        self._task = asyncio.create_task(show_guide_always(self.boxes, self.calibration.state))

    async def close(self) -> None:
        self._is_over = True
        await asyncio.to_thread(self.calibration.close)
        if self._task is not None:
            self._task.cancel()
        await super().close()

    @property
    def report(self) -> Path | None:
        return self.calibration.report

    def hear(self, told: dict[str, Any]) -> None:
        if answer := answer_in(told):
            self.calibration.answer(*answer)
        else:
            self.calibration.choose(told.get("calibrate"), told.get("step"), told.get("fields"))
        show_guide(self.boxes, self.calibration.state)

    # ---- pages, while the port is not theirs ----------------------------------------------------

    async def send(self, box: Outbox, frame: Frame) -> None:
        if self._stand_in is None:
            await super().send(box, frame)
        else:
            self._stand_in.hear(box, frame)

    async def leave(self, box: Outbox) -> None:
        if self._stand_in is None:
            await super().leave(box)
        else:
            self.boxes.pop(box, None)

    def _put(self, box: Outbox, frame: Frame) -> None:
        if self._stand_in is None or self._stand_in.forwards(frame):
            super()._put(box, frame)

    @contextlib.contextmanager
    def _borrowed(self) -> Iterator[Connection]:
        """The sensor, in the calibration's thread; pages get what it sends.

        Raises
        ------
        NoDeviceError
            It does not answer.
        """
        self._let_go()
        self.tell(self._hand_over)
        try:
            with Connection(self.port) as sensor:
                sensor.raw_sink = lambda data: self.tell(self._receive, data)
                self.tell(self._begin, StandIn(sensor))
                yield sensor
        finally:
            self.tell(self._end)
            if not self._is_over:
                self._take_back()

    def _hand_over(self) -> None:
        """Refuse commands until a stand-in or the sensor answers them."""
        self._stand_in, self._schema = Refusal(Schema.own(), HANDED_OVER), Schema.own()

    def _begin(self, stand_in: StandIn) -> None:
        """Pages greet the stand-in as they greet a sensor."""
        self._stand_in, self._schema = stand_in, stand_in.schema
        super()._say_open()

    def _end(self) -> None:
        self._hand_over()
        self._problem = f"{self.port} is not open again yet"

    def _say_lost(self, problem: str) -> None:
        if self._stand_in is not None:
            self._stand_in = Refusal(Schema.own(), problem)
        super()._say_lost(problem)

    def _say_open(self) -> None:
        """The port is open again: it belongs to the pages."""
        self._stand_in = None
        super()._say_open()
