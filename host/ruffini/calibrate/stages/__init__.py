"""The stages of `ruffini cal fit`, one module each, in the order in which one needs what another found.

A new estimator (a board's wrench matrix, a skin's light, a contact map) is one more module with a `STAGE` and one more
line in this table. A stage takes what it needs from the `Job` and leaves there what it found: tensors and metadata for
the calibration file, and numbers for the stages after it.
"""

from __future__ import annotations

from ruffini.calibrate.stages import (
    camera,
    contact,
    material,
    noise,
    operator,
    photometric,
    relaxation,
    skin,
    threshold,
    wrench,
)
from ruffini.calibrate.stages.job import Stage

STAGES: tuple[Stage, ...] = (
    camera.STAGE,
    photometric.STAGE,
    material.STAGE,
    relaxation.STAGE,
    noise.STAGE,
    operator.STAGE,
    threshold.STAGE,
    wrench.STAGE,
    contact.STAGE,
    skin.STAGE,
)
