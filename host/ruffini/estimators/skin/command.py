"""`cal fit --only skin`."""

from __future__ import annotations

from ruffini.estimators.command import Command

COMMAND = Command(
    "skin",
    former_verb="skin",
    gone_options={
        "--method": "skins are fitted by taxels alone, so leave it out",
        "--most-n": "it was of --method paper, and skins are fitted by taxels alone, so leave it out",
    },
)
