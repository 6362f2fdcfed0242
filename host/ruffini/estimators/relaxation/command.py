"""`cal fit --only relaxation`."""

from __future__ import annotations

from dataclasses import dataclass

from ruffini.estimators.command import Command, ReferenceOption


@dataclass(frozen=True)
class RelaxationOptions:
    """The reference of a recording."""

    reference: ReferenceOption = None


COMMAND = Command(
    "relaxation",
    "Fit how much force the pad loses under a held strain, and how fast, to a recording with a reference wrench; --out "
    "is JSON for `cal fit --only operator --relaxation`.",
    logs="Recording of touches held for seconds: video, or frames.",
    metavar="LOG",
    options=RelaxationOptions,
    former_verb="relaxation",
)
