"""`cal fit --only material`."""

from __future__ import annotations

from dataclasses import dataclass

from ruffini.estimators.command import Command, PlotOption, ReferenceOption


@dataclass(frozen=True)
class MaterialOptions:
    """The reference of a recording, and a picture of the fit."""

    reference: ReferenceOption = None
    plot: PlotOption = None


COMMAND = Command(
    "material",
    "Fit E, Poisson's ratio and thickness to a recording with a reference wrench, with 95 % intervals; --out is JSON "
    "for `cal fit --only operator --material`.",
    logs="Recording of touches: video, or folder of frames.",
    metavar="LOG",
    options=MaterialOptions,
    shared=("strain",),
    former_verb="material",
)
