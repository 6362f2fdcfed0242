"""`cal fit --only contact`."""

from __future__ import annotations

from ruffini.estimators.command import Command

COMMAND = Command(
    "contact",
    former_verb="contact",
    gone_options={"--report": "`--json` prints the report, > FILE keeps it"},
)
