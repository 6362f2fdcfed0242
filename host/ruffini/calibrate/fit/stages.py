"""The stages of `ruffini cal fit`, one module each, in the order in which one needs what another found.

A new estimator (a board's wrench matrix, a skin's light, a contact map) is one more module with a `STAGE` and one more
line in this table. A stage takes what it needs from the `Job` and leaves there what it found: tensors and metadata for
the calibration file, and numbers for the stages after it.
"""

from __future__ import annotations

from ruffini.calibrate.fit.job import Stage
from ruffini.estimators.camera import stage as camera
from ruffini.estimators.contact_model import stage as contact
from ruffini.estimators.material import stage as material
from ruffini.estimators.noise import stage as noise
from ruffini.estimators.operator import stage as operator
from ruffini.estimators.photometric import stage as photometric
from ruffini.estimators.relaxation import stage as relaxation
from ruffini.estimators.skin import stage as skin
from ruffini.estimators.threshold import stage as threshold
from ruffini.estimators.wrench import stage as wrench

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
