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
    red_1e3: Annotated[int, Field(ge=100, le=32_000)] | None = None
    blue_1e3: Annotated[int, Field(ge=100, le=32_000)] | None = None
    white_kelvin: Annotated[int, Field(ge=1_000, le=20_000)] | None = None

    @model_validator(mode="after")
    def _one_white(self) -> Exposure:
        gains = [gain is not None for gain in (self.red_1e3, self.blue_1e3)]
        if gains[0] != gains[1] or gains[0] == (self.white_kelvin is not None):
            raise ValueError("[exposure] needs red_1e3 and blue_1e3, or white_kelvin instead")
        return self


class Light(Section):
    """[light]: the GPIO line of the pad's lamps; lit_dark: every second frame of the camera is taken without them."""

    chip: DevicePath
    line: Annotated[str, Field(min_length=1, max_length=31, pattern=PRINTABLE)]
    alternation: Literal["none", "lit_dark"] = "none"

    @property
    def alternates(self) -> bool:
        """Whether it is lit_dark."""
        return self.alternation == "lit_dark"


class LedDriver(Section):
    """[led_driver]: the PCA9955B that the lamps hang on."""

    bus: DevicePath
    address: I2cAddress
    resistor_ohm: Annotated[int, Field(ge=500, le=10_000)]
    currents_ua: Annotated[list[Annotated[int, Field(ge=0, le=57_375)]], Field(min_length=1, max_length=16)]
    ramp_ms: Annotated[int, Field(ge=0, le=10_000)]
    max_milli_celsius: Annotated[int, Field(ge=0, le=150_000)] | None = None

    @model_validator(mode="after")
    def _fits(self) -> LedDriver:
        if not self.bus.startswith("/"):
            raise ValueError("led_driver.bus must begin with /")
        return self


class Stereo(Section):
    """[stereo]: two cameras, each of half the picture, side by side."""

    tolerance_us: Annotated[int, Field(ge=1, le=100_000)]


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


Priority = Annotated[int, Field(ge=1, le=49)] | None  # of SCHED_FIFO; the kernel's interrupt threads have 50
Cpus = Annotated[list[Annotated[int, Field(ge=0, le=63)]], Field(min_length=1)] | None


class Threads(Section):
    """[threads]: what the daemon's threads go before, and where they run."""

    capture_priority: Priority = None
    capture_cpus: Cpus = None
    frame_priority: Priority = None
    frame_cpus: Cpus = None
    link_priority: Priority = None
    link_cpus: Cpus = None
    inference_cpus: Cpus = None


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


def check_hardware(
    rate_mhz: int,
    width_px: int,
    *,
    exposure: Exposure | None,
    light: Light | None,
    stereo: Stereo | None,
    led_driver: LedDriver | None,
    has_thermometer: bool,
) -> None:
    """What no single section can tell; rate and width are [camera]'s.

    Raises
    ------
    ValueError
        They do not fit together.
    """
    alternates = light is not None and light.alternates
    n_exposures = 2 if alternates else 1
    if exposure is not None and n_exposures * exposure.time_us * rate_mhz > 1_000_000_000:
        raise ValueError(
            "exposure.time_us is longer than half a frame at camera.rate_mhz, which light.alternation takes two "
            "exposures in"
            if alternates
            else "exposure.time_us is longer than a frame at camera.rate_mhz"
        )
    if stereo is not None:
        if stereo.tolerance_us * 2 * rate_mhz > 1_000_000_000:
            raise ValueError("stereo.tolerance_us is longer than half a frame at camera.rate_mhz")
        if width_px % 2:
            raise ValueError("[stereo] needs an even camera.width_px: each camera makes half of it")
        if alternates:
            raise ValueError("[stereo] and light.alternation lit_dark cannot be had together")
    if alternates and exposure is None:
        raise ValueError("light.alternation lit_dark needs [exposure]: the camera's automatics would follow the lamps")
    if led_driver is not None and led_driver.max_milli_celsius is not None and not has_thermometer:
        raise ValueError("led_driver.max_milli_celsius needs [temperature]")
