"""board.toml as typed, checked settings: the same keys, ranges and refusals as the firmware's parser."""

from __future__ import annotations

import itertools
import os
import tomllib
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError, model_validator

from ruffini.boards.hardware import (
    Eeprom,
    Exposure,
    Learned,
    LedDriver,
    Light,
    Reflex,
    Stereo,
    Temperature,
    Threads,
    check_hardware,
)
from ruffini.boards.section import PRINTABLE, Listed, Text
from ruffini.boards.section import Section as Section
from ruffini.errors import InputError
from ruffini.files import readable

STAGES = (
    "difference", "markers", "targets", "photometric", "poisson", "displacement", "operator", "support",
    "wrench", "feature_wrench", "contacts", "skin", "contact_model", "fingertip", "helmholtz", "contact_depth",
)  # fmt: skip
MAX_LENGTH_UM = 500_000
MAX_CELLS = 640  # of the depth grid along one axis: the Poisson solver's accumulator bound
MAX_VIEW_UM = 2_000_000
MIN_TEXTURE_PX = 64  # of the image: the coarsest templates of the flow

MIN_TARGET_PX, MAX_TARGET_PX = 16, 200  # radius in the image

LengthUm = Annotated[int, Field(ge=0, le=MAX_LENGTH_UM)]
MAX_BYTES = 8_000  # of the file: HELLO carries it
MAX_CALIBRATION_KB = 131_072  # the most that one upload may carry


class BoardIdentity(Section):
    """[board]."""

    name: Text
    product: Annotated[str, Field(min_length=1, max_length=128, pattern=PRINTABLE)]
    not_measured: Annotated[list[Listed], Field(max_length=8)]


class Camera(Section):
    """[camera]: pinhole, 1/1000 pixel and micrometres."""

    optics: Text
    width_px: Annotated[int, Field(ge=16, le=4096)]
    height_px: Annotated[int, Field(ge=16, le=4096)]
    rate_mhz: Annotated[int, Field(ge=100, le=1_000_000)]
    focal_mpx: Annotated[int, Field(ge=10_000, le=20_000_000)]
    center_x_mpx: Annotated[int, Field(ge=0, le=4_096_000)]
    center_y_mpx: Annotated[int, Field(ge=0, le=4_096_000)]
    standoff_um: Annotated[int, Field(ge=1_000, le=MAX_LENGTH_UM)]


class Pad(Section):
    """[pad]."""

    size_x_um: Annotated[int, Field(ge=1_000, le=MAX_LENGTH_UM)]
    size_y_um: Annotated[int, Field(ge=1_000, le=MAX_LENGTH_UM)]
    thickness_um: Annotated[int, Field(ge=100, le=MAX_LENGTH_UM)]
    modulus_pa: Annotated[int, Field(ge=1_000, le=1_000_000_000)]
    poisson_1e4: Annotated[int, Field(ge=0, le=4_999)]
    stiffness_sigma_1e3: Annotated[int, Field(ge=0, le=500)] = 100


class Grid(Section):
    """[grid]: nodes of the inverse FEM over the whole pad."""

    n_x: Annotated[int, Field(ge=2, le=255)]
    n_y: Annotated[int, Field(ge=2, le=255)]
    n_layers: Annotated[int, Field(ge=2, le=32)]


class Window(Section):
    """[window]: what the camera observes, from the pad's corner."""

    min_x_um: LengthUm
    min_y_um: LengthUm
    max_x_um: LengthUm
    max_y_um: LengthUm


class Markers(Section):
    """[markers]: the printed lattice, or scattered markers: listed, or found in the rest picture.

    views : the frame is n_y views side by side, with n_x markers in each, found in the rest picture.
    """

    polarity: Literal["dark", "light", "texture"]
    layout: Literal["lattice", "scattered", "views"] = "lattice"
    places_um: (
        Annotated[list[Annotated[list[LengthUm], Field(min_length=2, max_length=2)]], Field(min_length=1)] | None
    ) = None
    n_x: Annotated[int, Field(ge=2, le=1024)]
    n_y: Annotated[int, Field(ge=2, le=64)]
    pitch_x_um: Annotated[int, Field(ge=100, le=100_000)]
    pitch_y_um: Annotated[int, Field(ge=100, le=100_000)]
    first_x_um: LengthUm
    first_y_um: LengthUm
    diameter_um: Annotated[int, Field(ge=20, le=50_000)]
    threshold_1e3: Annotated[int, Field(ge=10, le=1900)]
    max_lost: Annotated[int, Field(ge=0, le=4_096)]

    @model_validator(mode="after")
    def _is_within_its_layout(self) -> Markers:
        most_x, most_y = (1024, 4) if self.layout == "views" else (64, 64)
        if self.n_x > most_x or self.n_y > most_y:
            raise ValueError(f"markers.n_x is at most {most_x} and markers.n_y at most {most_y} in this layout")
        if self.threshold_1e3 > 900 and self.polarity != "light":
            raise ValueError("markers.threshold_1e3 is at most 900 unless markers are light")
        return self


class Targets(Section):
    """[targets]: dark discs on what carries the pad."""

    places_um: Annotated[
        list[Annotated[list[LengthUm], Field(min_length=2, max_length=2)]], Field(min_length=1, max_length=16)
    ]
    below_um: LengthUm
    diameter_um: Annotated[int, Field(ge=20, le=50_000)]
    threshold_1e3: Annotated[int, Field(ge=10, le=900)]


class Depth(Section):
    """[depth]."""

    source: Literal["light", "markers"] = "light"
    gauge: Literal["margin", "mean", "spacing", "volume", "both"]
    margin_um: LengthUm
    step_px: Annotated[int, Field(ge=1, le=4)]  # 3 is refused below; a Literal would take true and 1.0

    @property
    def has_gauge_table(self) -> bool:
        """Whether the free constant comes from a calibration's kind `gauge`."""
        return self.gauge not in ("margin", "mean")


class Contact(Section):
    """[contact]."""

    threshold_un: Annotated[int, Field(ge=1, le=100_000_000)]
    min_nodes: Annotated[int, Field(ge=1, le=10_000)]


class Skin(Section):
    """[skin]: a surface that gets brighter where it is pressed."""

    shape: Literal["plane", "tube", "dome"]
    radius_um: LengthUm
    n_panels: Annotated[int, Field(ge=1, le=64)]
    mode: Literal["single", "multi", "auto"]
    weight_b: Annotated[int, Field(ge=0, le=8)]
    weight_g: Annotated[int, Field(ge=0, le=8)]
    weight_r: Annotated[int, Field(ge=0, le=8)]
    level: Annotated[int, Field(ge=1, le=2_000)]
    min_area_px: Annotated[int, Field(ge=1, le=1_000_000)]
    averaged_frames: Annotated[int, Field(ge=1, le=10)]

    @property
    def weights(self) -> tuple[int, int, int]:
        """Of B, G, R."""
        return self.weight_b, self.weight_g, self.weight_r

    @model_validator(mode="after")
    def _fits(self) -> Skin:
        if not 1 <= sum(self.weights) <= 8:
            raise ValueError("[skin] weights must sum to 1 to 8")
        if (self.shape == "plane") != (self.radius_um == 0):
            raise ValueError("skin.radius_um must be 0 for a plane and above 0 for a tube or a dome")
        return self


class FieldSettings(Section):
    """[field]."""

    force_lsb_un: Annotated[int, Field(ge=1, le=1_000)]


class Memory(Section):
    """[memory]."""

    calibration_kb: Annotated[int, Field(ge=64, le=MAX_CALIBRATION_KB)]


class Pipeline(Section):
    """[pipeline]."""

    n_rest_frames: Annotated[int, Field(ge=1, le=256)]
    stages: list[str]


def observed_range(n: int, size_um: int, low_um: int, high_um: int) -> tuple[int, int]:
    """First node and number of nodes of [0, size] in n - 1 steps that lie in [low, high]."""
    first = -(-low_um * (n - 1) // size_um)
    return first, high_um * (n - 1) // size_um - first + 1


class Board(Section):
    """A whole board.toml; `folder` and `text` say where it came from."""

    schema_version: Annotated[int, Field(alias="schema", ge=1, le=1)]
    board: BoardIdentity
    camera: Camera
    exposure: Exposure | None = None
    light: Light | None = None
    led_driver: LedDriver | None = None
    stereo: Stereo | None = None
    eeprom: Eeprom | None = None
    pad: Pad
    grid: Grid
    window: Window
    markers: Markers | None = None  # a pipeline without the stage needs none
    targets: Targets | None = None
    depth: Depth
    contact: Contact
    skin: Skin | None = None
    field: FieldSettings
    temperature: Temperature | None = None
    learned: Learned | None = None
    reflex: Reflex | None = None
    threads: Threads | None = None
    memory: Memory | None = None
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

    @property
    def resolution(self) -> str:
        return f"{self.camera.width_px}x{self.camera.height_px}"

    @property
    def calibration_bytes(self) -> int:
        """Room for the calibration file."""
        return 1024 * (self.memory.calibration_kb if self.memory else MAX_CALIBRATION_KB)

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

    def _check_markers(self) -> None:
        markers, pad = self.markers, self.pad
        if markers is None:
            if "markers" in self.pipeline.stages or "displacement" in self.pipeline.stages:
                raise ValueError("section [markers] is missing")
            return
        if markers.layout == "scattered":
            self._check_scattered(markers)
        elif markers.layout == "views":
            self._check_views(markers)
        else:
            if markers.places_um is not None:
                raise ValueError('markers.places_um needs markers.layout = "scattered"')
            far_x = markers.first_x_um + (markers.n_x - 1) * markers.pitch_x_um
            far_y = markers.first_y_um + (markers.n_y - 1) * markers.pitch_y_um
            if far_x > pad.size_x_um or far_y > pad.size_y_um:
                raise ValueError("[markers] lattice reaches beyond the pad")
        if markers.diameter_um >= min(markers.pitch_x_um, markers.pitch_y_um):
            raise ValueError("markers.diameter_um must be below the pitch")
        if markers.polarity != "texture":
            return
        if "photometric" in self.pipeline.stages:
            raise ValueError(
                "markers.polarity texture leaves no shading to the stage photometric: leave one of them out"
            )
        if min(self.camera.width_px, self.camera.height_px) < MIN_TEXTURE_PX:
            raise ValueError(f"markers.polarity texture needs an image of at least {MIN_TEXTURE_PX} pixels a side")

    def _check_gauge(self) -> None:
        if not self.depth.has_gauge_table:
            return
        if not {"poisson", "displacement"} <= set(self.pipeline.stages):
            raise ValueError("depth.gauge spacing, volume and both need the stages poisson and displacement")
        if self.markers is not None and self.markers.layout != "lattice":
            raise ValueError("depth.gauge spacing, volume and both need markers.layout lattice")

    def _check_depth(self) -> None:
        stages = self.pipeline.stages
        if self.depth.source == "light":
            return
        if "displacement" not in stages:
            raise ValueError("depth.source markers needs the stage displacement")
        if "photometric" in stages or "poisson" in stages:
            raise ValueError(
                "depth.source markers takes no depth from light: leave the stages photometric and poisson out"
            )
        if self.markers is not None and self.markers.layout != "lattice":
            raise ValueError("depth.source markers needs markers.layout lattice")

    def _check_targets(self) -> None:
        stages, targets = self.pipeline.stages, self.targets
        if "feature_wrench" in stages:
            if "targets" not in stages and "markers" not in stages:
                raise ValueError("stage feature_wrench needs the stage targets or markers")
            if "wrench" in stages:
                raise ValueError("stages wrench and feature_wrench both say the wrench: leave one of them out")
        if "contact_model" in stages:
            is_texture = self.markers is not None and self.markers.polarity == "texture"
            if "feature_wrench" not in stages or not is_texture:
                raise ValueError("stage contact_model needs the stage feature_wrench and markers.polarity texture")
            if "contacts" in stages:
                raise ValueError("stages contacts and contact_model both say the contacts: leave one of them out")
        if "contact_model" not in stages and not {"helmholtz", "contact_depth"}.isdisjoint(stages):
            raise ValueError("stages helmholtz and contact_depth need the stage contact_model")
        if "helmholtz" in stages and self.markers is not None:
            m = self.markers
            if max(m.pitch_x_um, m.pitch_y_um) > 4 * min(m.pitch_x_um, m.pitch_y_um):
                raise ValueError("stage helmholtz needs markers.pitch_x_um and pitch_y_um within four times each other")
        if targets is None:
            if "targets" in stages:
                raise ValueError("section [targets] is missing")
            return
        if any(x > self.pad.size_x_um or y > self.pad.size_y_um for x, y in targets.places_um):
            raise ValueError("targets.places_um reaches beyond the pad")
        distance_um = self.camera.standoff_um - targets.below_um
        if distance_um <= 0:
            raise ValueError("targets.below_um is not in front of the camera")
        radius_px = targets.diameter_um * self.camera.focal_mpx // (2000 * distance_um)
        if not MIN_TARGET_PX <= radius_px <= MAX_TARGET_PX:
            raise ValueError(
                f"targets.diameter_um makes a radius of {radius_px} px in the image: "
                f"{MIN_TARGET_PX} to {MAX_TARGET_PX} can be measured"
            )

    def _check_fingertip(self) -> None:
        if "fingertip" not in self.pipeline.stages:
            return
        markers = self.markers
        if markers is None or markers.layout != "views" or markers.n_y != 2 or "markers" not in self.pipeline.stages:
            raise ValueError("stage fingertip needs the stage markers and markers.layout views with n_y 2")

    def _check_views(self, markers: Markers) -> None:
        if markers.polarity == "texture":
            raise ValueError("markers.polarity texture needs markers.layout lattice")
        if markers.places_um is not None:
            raise ValueError('markers.places_um needs markers.layout = "scattered"')
        if self.camera.width_px % markers.n_y:
            raise ValueError("camera.width_px is no multiple of the markers.n_y views that it holds")
        if {"displacement", "photometric"} & set(self.pipeline.stages):
            raise ValueError("markers.layout views has no nodes: leave the stages displacement and photometric out")

    def _check_scattered(self, markers: Markers) -> None:
        if markers.polarity == "texture":
            raise ValueError("markers.polarity texture needs markers.layout lattice")
        places, n = markers.places_um, markers.n_x * markers.n_y
        if places is None:
            return
        if len(places) != n:
            raise ValueError(f"markers.places_um lists {len(places)} places, but n_x times n_y is {n}")
        if any(x > self.pad.size_x_um or y > self.pad.size_y_um for x, y in places):
            raise ValueError("markers.places_um reaches beyond the pad")
        if len({(x, y) for x, y in places}) != n:
            raise ValueError("markers.places_um lists a place twice")

    @model_validator(mode="after")
    def _cross_check(self) -> Board:
        window, pad, camera = self.window, self.pad, self.camera
        if window.max_x_um > pad.size_x_um or window.max_y_um > pad.size_y_um:
            raise ValueError("[window] reaches beyond the pad")
        if window.min_x_um >= window.max_x_um or window.min_y_um >= window.max_y_um:
            raise ValueError("[window] is empty: min must be below max")
        rows, columns = self.observed
        if rows.stop - rows.start < 2 or columns.stop - columns.start < 2:
            raise ValueError("[window] holds fewer than 2 node lines: widen it or refine [grid]")
        check_hardware(
            camera.rate_mhz, camera.width_px, exposure=self.exposure, light=self.light, stereo=self.stereo,
            led_driver=self.led_driver, has_thermometer=self.temperature is not None,
        )  # fmt: skip
        self._check_markers()
        self._check_fingertip()
        self._check_gauge()
        self._check_depth()
        if self.skin is None and "skin" in self.pipeline.stages:
            raise ValueError("section [skin] is missing")
        self._check_targets()
        step = self.depth.step_px
        if step == 3 or camera.width_px % step or camera.height_px % step:
            raise ValueError("depth.step_px must be 1, 2 or 4 and divide the image")
        if max(camera.width_px, camera.height_px) // step > MAX_CELLS:
            raise ValueError(f"the depth grid has more than {MAX_CELLS} cells: use a larger depth.step_px")
        if camera.center_x_mpx >= 1000 * camera.width_px or camera.center_y_mpx >= 1000 * camera.height_px:
            raise ValueError("[camera] center is outside the image")
        widest = max(camera.width_px, camera.height_px)
        if widest * 1000 * camera.standoff_um > MAX_VIEW_UM * camera.focal_mpx:
            raise ValueError("[camera] sees more than 2 m of pad: check focal_mpx and standoff_um")
        places = [STAGES.index(s) if s in STAGES else -1 for s in self.pipeline.stages]
        if not places or min(places) < 0 or any(b <= a for a, b in itertools.pairwise(places)):
            raise ValueError(f"pipeline.stages must be some of {', '.join(STAGES)}, in this order")
        return self


def parse_board(text: str | bytes, where: str) -> Board:
    """Board of a board.toml's text; `where` names the file in messages.

    Raises
    ------
    InputError
        Too long, not plain ASCII, a byte-order mark, not TOML, an unknown, missing, mistyped or out-of-range key.
    """
    raw = text.encode() if isinstance(text, str) else text
    if len(raw) > MAX_BYTES:
        raise InputError(f"{where}: has more than {MAX_BYTES} bytes: move comments into the board's README.md")
    if raw.startswith(b"\xef\xbb\xbf"):
        raise InputError(f"{where}: starts with a byte-order mark: save it without one")
    odd = next((i for i, byte in enumerate(raw) if not (byte in b"\t\n\r" or 0x20 <= byte <= 0x7E)), None)
    if odd is not None:
        raise InputError(f"{where}:{1 + raw[:odd].count(10)}: a character that is not plain ASCII")
    decoded = raw.decode("ascii")
    try:
        tree = tomllib.loads(decoded)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputError(f"{where}: not TOML: {error}") from error
    try:
        board = Board.model_validate(tree)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        kind = {"extra_forbidden": "unknown key, check the spelling or remove it",
                "missing": "key is missing",
                "string_pattern_mismatch": "must be printable ASCII"}.get(first["type"], first["msg"])  # fmt: skip
        raise InputError(f"{where}: {key + ': ' if key else ''}{kind} (boards/README.md lists the keys)") from error
    object.__setattr__(board, "_text", decoded)
    return board


def boards_folder() -> Path:
    """Where the boards are: RUFFINI_BOARDS, beside the package, or the repository's boards/."""
    candidates = [Path(p) for p in (os.environ.get("RUFFINI_BOARDS"),) if p]
    here = Path(__file__).resolve()
    candidates += [here.parent / "data", here.parents[3] / "boards"]
    for folder in candidates:
        if folder.is_dir():
            return folder
    raise InputError("no boards folder found: set RUFFINI_BOARDS to one")


def board_names() -> list[str]:
    """Names of the boards that come with ruffini."""
    return sorted(p.parent.name for p in boards_folder().glob("*/board.toml"))


def find_board(name_or_folder: str | Path) -> Board:
    """A board by name, or anybody's folder that holds a board.toml.

    Raises
    ------
    InputError
        Nothing there, or the file is refused; or [board] name is not the folder's name.
    """
    folder = Path(name_or_folder)
    if not (folder / "board.toml").is_file():
        folder = boards_folder() / str(name_or_folder)
    path = folder / "board.toml"
    if not path.is_file():
        raise InputError(
            f"no board {str(name_or_folder)!r}: give a folder with a board.toml or one of {', '.join(board_names())}"
        )
    board = parse_board(readable(path).read_bytes(), str(path))
    if board.name != path.resolve().parent.name:
        raise InputError(
            f"{path}: board.name is {board.name!r} but the folder is called {path.resolve().parent.name!r}"
        )
    object.__setattr__(board, "_folder", folder)
    return board
