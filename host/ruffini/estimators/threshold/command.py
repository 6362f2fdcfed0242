"""`cal fit --only threshold`."""

from __future__ import annotations

from ruffini.estimators.command import Command

COMMAND = Command("threshold", former_verb="touch")
