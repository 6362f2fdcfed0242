"""Optional sections of board.toml about what is round the sensor: camera's exposure, lamps, memories, thermometer."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from ruffini.boards.section import PRINTABLE, Listed, Section, Text

DevicePath = Annotated[str, Field(min_length=1, max_length=128, pattern=PRINTABLE)]
I2cAddress = Annotated[int, Field(ge=8, le=0x77)]  # the others are the bus's own


class Exposure(Section):
    """[exposure]: what the camera is told instead of its automatics."""

    time_us: Annotated[int, Field(ge=10, le=1_000_000)]
    gain_1e3: Annotated[int, Field(ge=1_000, le=64_000)]
    red_1e3: Annotated[int, Field(ge=100, le=32_000)]
    blue_1e3: Annotated[int, Field(ge=100, le=32_000)]


class Light(Section):
    """[light]: the GPIO line of the pad's lamps."""

    chip: DevicePath
    line: Annotated[str, Field(min_length=1, max_length=31, pattern=PRINTABLE)]


class Eeprom(Section):
    """[eeprom]: memories that say which board and which gel these are."""

    bus: DevicePath
    board_address: I2cAddress | None = None
    gel_address: I2cAddress | None = None
    address_bytes: Annotated[int, Field(ge=1, le=2)]

    @model_validator(mode="after")
    def _fits(self) -> Eeprom:
        if not self.bus.startswith("/"):
            raise ValueError("eeprom.bus must begin with /")
        if self.board_address == self.gel_address:
            raise ValueError("[eeprom] needs board_address or gel_address, and not the same for both")
        return self


class Temperature(Section):
    """[temperature]: a thermometer of Linux."""

    place: Listed
    path: Annotated[str, Field(min_length=1, max_length=128, pattern=PRINTABLE)]

    @model_validator(mode="after")
    def _fits(self) -> Temperature:
        if not self.path.startswith("/"):
            raise ValueError("temperature.path must begin with /")
        return self


class Learned(Section):
    """[learned]: a network beside the frame path, by its file in the device's store."""

    network: Text

    @model_validator(mode="after")
    def _fits(self) -> Learned:
        if "/" in self.network:
            raise ValueError("learned.network must be a name without /")
        return self


class Reflex(Section):
    """[reflex]: an output line of the device that switches on a force or slip limit."""

    chip: Annotated[str, Field(min_length=1, max_length=128, pattern=PRINTABLE)]
    line: Annotated[str, Field(min_length=1, max_length=31, pattern=PRINTABLE)]
    force_un: Annotated[int, Field(ge=0, le=2_000_000_000)]
    slip: Literal["none", "incipient", "slides"]
    when_invalid: Literal["hold", "on", "off"]

    @model_validator(mode="after")
    def _has_a_limit(self) -> Reflex:
        if self.force_un == 0 and self.slip == "none":
            raise ValueError("[reflex] has no limit: give force_un above 0, or slip")
        return self
