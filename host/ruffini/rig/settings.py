"""A bench in a file: which reference, which stage, where the pad is, how far and how hard. Strict.

schema = 1
[reference]
kind = "text"               # i2c: part_number, bus; network: host, full_scale, sigma (six each, N and N m)
port = "/dev/ttyUSB0"
unit = "g"
full_scale_n = 20.0
sigma_n = 0.005
[stage]
kind = "marlin"             # or grbl
port = "/dev/ttyACM1"
origin_mm = [110.0, 95.0, 42.0]   # the machine's coordinates with the tip on the middle of the pad
[limits]
half_x_mm = 8.0
half_y_mm = 6.0
top_mm = 3.0
bottom_mm = -1.5
deepest_mm = 1.2
max_force_n = 6.0
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ruffini.errors import InputError
from ruffini.rig.grbl import Grbl
from ruffini.rig.guarded_stage import Limits
from ruffini.rig.i2c_cell import I2cCell
from ruffini.rig.marlin import Marlin
from ruffini.rig.network_cell import NetworkCell
from ruffini.rig.reference import Reference
from ruffini.rig.stage import Place, Stage
from ruffini.rig.text_cell import TextCell

Positive = Annotated[float, Field(gt=0, le=1e4)]
Six = Annotated[list[Positive], Field(min_length=6, max_length=6)]
Mm = Annotated[float, Field(ge=-2000, le=2000)]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class I2cSettings(_Section):
    """An FX29."""

    kind: Literal["i2c"]
    part_number: str
    bus: Annotated[int, Field(ge=0, le=255)] = 1
    sigma_n: Positive | None = None

    def open(self) -> Reference:
        """Connect to it."""
        return I2cCell(self.part_number, self.bus, sigma_n=self.sigma_n)


class TextSettings(_Section):
    """A board that prints."""

    kind: Literal["text"]
    port: str
    unit: str
    full_scale_n: Positive
    sigma_n: Positive
    baud: Annotated[int, Field(ge=300, le=4_000_000)] = 115200
    rate_hz: Positive = 10.0
    is_inverted: bool = False

    def open(self) -> Reference:
        """Connect to it."""
        return TextCell(self.port, self.unit, self.full_scale_n, self.sigma_n, baud=self.baud, rate_hz=self.rate_hz,
                        is_inverted=self.is_inverted)  # fmt: skip


class NetworkSettings(_Section):
    """Six axes over UDP."""

    kind: Literal["network"]
    host: str
    full_scale: Six
    sigma: Six

    def open(self) -> Reference:
        """Connect to it."""
        return NetworkCell(self.host, np.array(self.full_scale), np.array(self.sigma))


class StageSettings(_Section):
    """A G-code machine."""

    kind: Literal["marlin", "grbl"]
    port: str
    origin_mm: Annotated[list[Mm], Field(min_length=3, max_length=3)]
    baud: Annotated[int, Field(ge=300, le=4_000_000)] = 115200

    @property
    def origin(self) -> Place:
        """The pad's centre in the machine's coordinates."""
        return Place(*(1e-3 * v for v in self.origin_mm))

    def open(self) -> Stage:
        """Connect to it."""
        return Marlin(self.port, baud=self.baud) if self.kind == "marlin" else Grbl(self.port, baud=self.baud)


class LimitSettings(_Section):
    """Soft limits from the pad's centre."""

    half_x_mm: Positive
    half_y_mm: Positive
    top_mm: Positive
    bottom_mm: Annotated[float, Field(ge=-50, lt=0)]
    deepest_mm: Positive
    max_force_n: Positive

    @property
    def limits(self) -> Limits:
        """In metres."""
        return Limits(
            half_x_m=1e-3 * self.half_x_mm, half_y_m=1e-3 * self.half_y_mm, top_m=1e-3 * self.top_mm,
            bottom_m=1e-3 * self.bottom_mm, deepest_m=1e-3 * self.deepest_mm, max_force_n=self.max_force_n,
        )  # fmt: skip


class RigSettings(_Section):
    """The whole file."""

    schema_: Annotated[Literal[1], Field(alias="schema")]
    reference: Annotated[I2cSettings | TextSettings | NetworkSettings, Field(discriminator="kind")]
    stage: StageSettings
    limits: LimitSettings


def load_rig(path: Path) -> RigSettings:
    """Read a bench's file.

    Raises
    ------
    InputError
        Unreadable, or a line that is not understood; the text names it.
    """
    try:
        return RigSettings.model_validate(tomllib.loads(path.read_text()))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from error
    except ValidationError as error:
        first = error.errors()[0]
        raise InputError(f"{path}: {'.'.join(str(p) for p in first['loc'])}: {first['msg']}") from error
