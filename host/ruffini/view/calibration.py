"""A calibration from the page alone: what the page shows, and what a person chooses there."""

from __future__ import annotations

import contextlib
import errno
import logging
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ruffini.device import Connection
from ruffini.errors import RuffiniError
from ruffini.view.steps import CLOSE, CLOSED, OPEN, Step

if TYPE_CHECKING:
    from ruffini.view.scale_calibration import ScaleCalibration

MAX_TEXT = 100  # characters of a field
CLOSE_S = 5.0  # for a press under way to end with the server


class Calibration:
    """Steps of the calibration of one sensor; each choice runs in a worker thread, one at a time.

    Parameters
    ----------
    borrow : gives the sensor to the thread that asks, and takes it back.
    folder : of this unit's calibrations; None: below XDG_STATE_HOME, by board and serial number.
    """

    def __init__(
        self, borrow: Callable[[], contextlib.AbstractContextManager[Connection]], folder: Path | None
    ) -> None:
        self._borrow, self._folder = borrow, folder
        self._step, self._number = CLOSED, 0
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._work: ScaleCalibration | None = None

    def state(self) -> dict[str, Any]:
        """As JSON takes it."""
        step, number, work = self._step, self._number, self._work
        shown = work.told() if work is not None and step.phase == "press" else {"said": step.said}
        return {
            **shown, "program": work.board_name if work else "", "phase": step.phase, "step": number,
            "text": step.text, "is_bad": step.is_bad, "part": step.part,
            "choices": [choice._asdict() for choice in step.choices],
            "fields": [one._asdict() for one in step.fields], "gates": [row._asdict() for row in step.gates],
            "report": number if step.has_report else None, "end": None,
        }  # fmt: skip

    @property
    def report(self) -> Path | None:
        """The HTML page of the report that is shown."""
        return None if self._work is None else self._work.page

    def answer(self, word: str, number: int, typed: str) -> None:
        """To a question while a person presses."""
        if self._work is not None and self._step.phase == "press":
            self._work.answer(word, number, typed)

    def choose(self, word: object, step: object, fields: object) -> None:
        """What a page chose; ignored if it was chosen at a step that is over, as in a second browser that is late."""
        with self._lock:
            if step != self._number or word not in [choice.word for choice in self._step.choices]:
                return
            if word == CLOSE.word:
                self._show(CLOSED)
                return
            given = fields if isinstance(fields, dict) else {}
            texts = {str(name): text[:MAX_TEXT] for name, text in given.items() if isinstance(text, str)}
            before = self._step
            self._show(Step("work", "One moment"))
            self._thread = threading.Thread(
                target=self._run, args=(str(word), texts, before), name="calibration", daemon=True
            )
            self._thread.start()

    def close(self) -> None:
        """End a press under way; a fit is abandoned. The presses are kept."""
        if self._thread is not None and self._work is not None and self._step.phase == "press":
            self._work.stop()
            self._thread.join(CLOSE_S)

    def _show(self, step: Step) -> None:
        self._step, self._number = step, self._number + 1

    def _progress(self, said: str, part: float | None = None) -> None:
        """Of the work under way; nothing can be chosen then."""
        self._step = Step("work", said, part=part)

    def _run(self, word: str, fields: dict[str, str], before: Step) -> None:
        from ruffini.view.scale_calibration import ScaleCalibration  # the fits take a second to import

        if self._work is None:
            self._work = ScaleCalibration(self._borrow, self._show, self._progress, self._folder)
        work = self._work
        try:
            work.run(word, fields)
            return
        except RuffiniError as error:
            why = str(error)
        except OSError as error:
            why = _told(error, work.current)
        except Exception as error:
            logging.getLogger("ruffini.view").exception("calibration")
            why = f"this is a fault of ruffini ({error!r})"
        why = why if why.endswith((".", "?")) else f"{why}."
        if word in ("flash", "undo") or (before.fields and work.current is None):
            filled = tuple(one._replace(value=fields.get(one.name, one.value)) for one in before.fields)
            self._show(replace(before, text=why, is_bad=True, fields=filled))
        elif work.current is None:
            again = OPEN._replace(label="Again")
            self._show(Step("ended", "It did not work", why, is_bad=True, choices=(again, CLOSE)))
        else:
            self._show(work.after_failure(why))


def _told(error: OSError, folder: Path | None) -> str:
    """What failed, where, and what to do if that is known; h5py names neither file nor number."""
    where = error.filename or folder
    what = f"{where}: {error.strerror or error}" if where else str(error.strerror or error)
    return f"{what}: make room, then continue" if error.errno in (errno.ENOSPC, errno.EDQUOT) else what
