"""The table of commands: a line for each estimator that takes options of its own, or had another name."""

from __future__ import annotations

from ruffini.estimators.camera.command import COMMAND as CAMERA
from ruffini.estimators.command import Command
from ruffini.estimators.contact_model.command import COMMAND as CONTACT
from ruffini.estimators.dark.command import COMMAND as DARK
from ruffini.estimators.fingertip.command import COMMAND as FINGERTIP
from ruffini.estimators.material.command import COMMAND as MATERIAL
from ruffini.estimators.operator.command import COMMAND as OPERATOR
from ruffini.estimators.photometric.command import COMMAND as PHOTOMETRIC
from ruffini.estimators.relaxation.command import COMMAND as RELAXATION
from ruffini.estimators.skin.command import COMMAND as SKIN
from ruffini.estimators.threshold.command import COMMAND as THRESHOLD
from ruffini.estimators.wrench.command import COMMAND as WRENCH

COMMANDS: tuple[Command, ...] = (
    OPERATOR,
    MATERIAL,
    RELAXATION,
    PHOTOMETRIC,
    CAMERA,
    DARK,
    WRENCH,
    CONTACT,
    FINGERTIP,
    SKIN,
    THRESHOLD,
)


def command_named(name: str | None) -> Command | None:
    """That of a stage, by its name or by that of the release before; None: the stage has none."""
    return next((one for one in COMMANDS if name and name in (one.name, one.former_verb)), None)
