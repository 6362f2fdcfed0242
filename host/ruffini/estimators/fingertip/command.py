"""`cal fit --only fingertip`."""

from __future__ import annotations

from ruffini.estimators.command import Command

COMMAND = Command("fingertip", former_verb="fingertip", former_options={"--only": "--pattern"})
