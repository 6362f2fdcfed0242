"""What every section of board.toml is made of."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

PRINTABLE = r"^[ -~]+$"  # escapes can spell what the file itself may not hold
Text = Annotated[str, Field(min_length=1, max_length=64, pattern=PRINTABLE)]
Listed = Annotated[str, Field(min_length=1, max_length=23, pattern=PRINTABLE)]


class Section(BaseModel):
    """A table of the file: unknown keys are errors, nothing is converted."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)
