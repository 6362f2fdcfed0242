"""What board.toml holds. Keys, units and ranges: boards/README.md; the firmware's parser checks them."""

from __future__ import annotations

from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field

from ruffini.native import stage_slots


class Section(BaseModel):
    """A table of a settings file: unknown keys are errors, nothing is converted."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class BoardIdentity(Section):
    """[board]."""

    name: str
    product: str
    not_measured: list[str]


class Camera(Section):
    """[camera]: pinhole, 1/1000 pixel and micrometres."""

    optics: str
    width_px: int
    height_px: int
    rate_mhz: int
    focal_mpx: int
    center_x_mpx: int
    center_y_mpx: int
    standoff_um: int


class Pad(Section):
    """[pad]."""

    size_x_um: int
    size_y_um: int
    thickness_um: int
    modulus_pa: int
    poisson_1e4: int
    stiffness_sigma_1e3: int


class Grid(Section):
    """[grid]: nodes of the inverse FEM over the whole pad."""

    n_x: int
    n_y: int
    n_layers: int


class Window(Section):
    """[window]: what the camera observes, from the pad's corner."""

    min_x_um: int
    min_y_um: int
    max_x_um: int
    max_y_um: int


class Markers(Section):
    """[markers]: the printed lattice, or scattered markers: listed, or found in the rest picture.

    views : the frame is n_y views side by side, with n_x markers in each, found in the rest picture.
    """

    polarity: str
    layout: str
    places_um: list[list[int]] | None = None
    n_x: int
    n_y: int
    pitch_x_um: int
    pitch_y_um: int
    first_x_um: int
    first_y_um: int
    diameter_um: int
    threshold_1e3: int
    max_lost: int


class Targets(Section):
    """[targets]: dark discs on what carries the pad."""

    places_um: list[list[int]]
    below_um: int
    diameter_um: int
    threshold_1e3: int


class PictureFeatures(Section):
    """[picture_features]: a grid on the gel, whose corners in the picture go from the top left with the clock."""

    corners_px: list[list[int]]
    n_x: int
    n_y: int


class Depth(Section):
    """[depth]."""

    source: str
    gauge: str
    margin_um: int
    step_px: int

    @property
    def has_gauge_table(self) -> bool:
        """Whether the free constant comes from a calibration's kind `gauge`."""
        return self.gauge not in ("margin", "mean")


class Contact(Section):
    """[contact]."""

    threshold_un: int
    min_nodes: int
    steady_frames: int


class Skin(Section):
    """[skin]: a surface that gets brighter where it is pressed."""

    shape: str
    radius_um: int
    n_panels: int
    mode: str
    weight_b: int
    weight_g: int
    weight_r: int
    level: int
    min_area_px: int
    averaged_frames: int

    @property
    def weights(self) -> tuple[int, int, int]:
        """Of B, G, R."""
        return self.weight_b, self.weight_g, self.weight_r


class FieldSettings(Section):
    """[field]."""

    force_lsb_un: int


class Memory(Section):
    """[memory]."""

    calibration_kb: int


class Pipeline(Section):
    """[pipeline]."""

    n_rest_frames: int
    stages: list[str]
    cores: int


class Exposure(Section):
    """[exposure]: fixed settings in place of the camera's automatic ones."""

    time_us: int
    gain_1e3: int
    red_1e3: int | None = None
    blue_1e3: int | None = None
    white_kelvin: int | None = None


class Usb(Section):
    """[usb]: how a computer recognises the sensor on USB: identity, or a part of its camera's name."""

    vendor: int | None = None
    product: int | None = None
    names: list[str] | None = None


class Light(Section):
    """[light]: the GPIO line of the pad's lamps; lit_dark: every second frame of the camera is taken without them."""

    chip: str
    line: str
    alternation: str

    @property
    def alternates(self) -> bool:
        """Whether it is lit_dark."""
        return self.alternation == "lit_dark"


class LedDriver(Section):
    """[led_driver]: the PCA9955B that the lamps hang on."""

    bus: str
    address: int
    resistor_ohm: int
    currents_ua: list[int]
    ramp_ms: int
    max_milli_celsius: int | None = None


class Stereo(Section):
    """[stereo]: two cameras, each of half the picture, side by side."""

    tolerance_us: int


class Eeprom(Section):
    """[eeprom]: memories that say which board and which gel these are."""

    bus: str
    board_address: int | None = None
    gel_address: int | None = None
    address_bytes: int


class Threads(Section):
    """[threads]: what the daemon's threads go before, and where they run."""

    capture_priority: int | None = None
    capture_cpus: list[int] | None = None
    frame_priority: int | None = None
    frame_cpus: list[int] | None = None
    link_priority: int | None = None
    link_cpus: list[int] | None = None
    inference_cpus: list[int] | None = None


class Temperature(Section):
    """[temperature]: a thermometer of Linux."""

    place: str
    path: str


class Learned(Section):
    """[learned]: a network beside the frame path, by its file in the device's store."""

    network: str


class Reflex(Section):
    """[reflex]: an output line of the device that switches on a force or slip limit."""

    chip: str
    line: str
    force_un: int
    slip: str
    when_invalid: str


def observed_range(n: int, size_um: int, low_um: int, high_um: int) -> tuple[int, int]:
    """First node and number of nodes of [0, size] in n - 1 steps that lie in [low, high]."""
    first = -(-low_um * (n - 1) // size_um)
    return first, high_um * (n - 1) // size_um - first + 1


class Board(Section):
    """A whole board.toml; `folder` and `text` say where it came from."""

    schema_version: int = Field(alias="schema")
    board: BoardIdentity
    camera: Camera
    exposure: Exposure | None = None
    usb: Usb | None = None
    light: Light | None = None
    led_driver: LedDriver | None = None
    stereo: Stereo | None = None
    eeprom: Eeprom | None = None
    pad: Pad
    grid: Grid
    window: Window
    markers: Markers | None = None  # a pipeline without the stage needs none
    targets: Targets | None = None
    picture_features: PictureFeatures | None = None
    depth: Depth
    contact: Contact
    skin: Skin | None = None
    field: FieldSettings
    temperature: Temperature | None = None
    learned: Learned | None = None
    reflex: Reflex | None = None
    threads: Threads | None = None
    memory: Memory
    pipeline: Pipeline

    _text: str = ""
    _folder: Path | None = None

    @property
    def name(self) -> str:
        return self.board.name

    @property
    def text(self) -> str:
        """The file as it stands."""
        return self._text

    @property
    def folder(self) -> Path | None:
        return self._folder

    def writes(self, slot: str) -> bool:
        """True if one of the board's stages writes the slot (firmware/core/slots.h)."""
        return any(slot in stage_slots()[stage] for stage in self.pipeline.stages)

    @property
    def resolution(self) -> str:
        return f"{self.camera.width_px}x{self.camera.height_px}"

    @property
    def calibration_bytes(self) -> int:
        """Room for the calibration file."""
        return 1024 * self.memory.calibration_kb

    @property
    def observed(self) -> tuple[slice, slice]:
        """Node rows and columns inside the window."""
        y = observed_range(self.grid.n_y, self.pad.size_y_um, self.window.min_y_um, self.window.max_y_um)
        x = observed_range(self.grid.n_x, self.pad.size_x_um, self.window.min_x_um, self.window.max_x_um)
        return slice(y[0], y[0] + y[1]), slice(x[0], x[0] + x[1])

    @property
    def alternates(self) -> bool:
        """Whether every second frame of the camera is taken with the lamps off; camera.rate_mhz counts pairs."""
        return self.light is not None and self.light.alternates
