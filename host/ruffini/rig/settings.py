"""A bench in a file: which reference, which stage, where the pad is, how far and how hard. Strict.

schema = 1
[reference]
kind = "text"               # all keys: the classes below. i2c: part_number; network: host, full_scale, sigma (six
                            # each, N and N m), axes (which of its axes are the pad's: ["+y", "-x", "+z"]), arm_mm
                            # (the pad's centre from its origin; needed with a connector); m8128: port, baud or
                            # host (as shipped "192.168.0.108"), tcp_port; rate_hz, full_scale, sigma, axes, arm_mm;
                            # weight: sigma_g; hid: path ("/dev/hidraw0"); csv: path, and of a log of six voltages
                            # columns (their names, in the gauges' order) and matrix (six rows Fx Fy Fz Tx Ty Tz of
                            # six numbers from the certificate, N and N m per volt)
port = "/dev/ttyUSB0"
unit = "g"
full_scale_n = 20.0
sigma_n = 0.005
[stage]                     # without it: programs by hand
kind = "marlin"             # or grbl
port = "/dev/ttyACM1"
origin_mm = [110.0, 95.0, 42.0]   # the machine's coordinates with the tip on the middle of the pad
rotary_axis = "A"           # of a board that is a tube: the axis in degrees that turns it under the tip; x, also in
                            # half_x_mm, is then the way round it
rotary_origin_deg = 0.0     # its position there
[tip]                       # what touches the pad
shape = "sphere"
diameter_mm = 6.0
[[indenters]]               # of program indenters, instead of [tip]: each that a person can mount
name = "A1"                 # as written on it
shape = "square"            # sphere, flat (a disc), square, hexagon, triangle, ring; other: none of these
size_mm = 10.0              # diameter; of a square or hexagon across its flats, of a triangle its side
shore_a = 40.0              # without it: rigid
[holder]                    # of a fingertip: turned to each of these angles
# roll, pitch of the tip's axis in the fingertip's (holder.py)
tilts_deg = [[0.0, 0.0], [20.0, 0.0], [-40.0, 0.0], [0.0, 30.0], [0.0, -40.0], [25.0, -25.0]]
axes = ["A", "-B"]          # of a five-axis stage, which turns it itself: outer and inner; - if it turns the other way
pivot_mm = 22.0             # from the top down to where its axes meet; without it: the middle of the sphere
[limits]                    # without a stage only max_force_n
half_x_mm = 8.0
half_y_mm = 6.0
top_mm = 3.0
bottom_mm = -1.5
deepest_mm = 1.2
near_mm = 1.0               # above the pad: as well as origin_mm is known; down to there the tip moves fast
max_force_n = 6.0
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from ruffini.boards import Board
from ruffini.errors import InputError
from ruffini.files import readable
from ruffini.older_python import tomllib
from ruffini.rig.byte_line import ByteLine, SerialLine, TcpLine
from ruffini.rig.csv_log import Gauges, gauges_of
from ruffini.rig.grbl import Grbl
from ruffini.rig.guarded_stage import Limits
from ruffini.rig.hid_scale import HidScale
from ruffini.rig.holder import Holder
from ruffini.rig.i2c_cell import I2cCell
from ruffini.rig.marlin import Marlin
from ruffini.rig.network_cell import NetworkCell, fetch_settings
from ruffini.rig.packet_cell import BAUD, RATE_HZ, TCP_PORT, PacketCell
from ruffini.rig.placed_weight import SCALE_SIGMA_G, PlacedWeight
from ruffini.rig.program import Span, Tool
from ruffini.rig.reference import Reference
from ruffini.rig.stage import Place, Rotary, Stage
from ruffini.rig.text_cell import TextCell
from ruffini.rig.turned import Turned, turn_of
from ruffini.rig.units import force_factor

Positive = Annotated[float, Field(gt=0, le=1e4)]
Six = Annotated[list[Positive], Field(min_length=6, max_length=6)]
Mm = Annotated[float, Field(ge=-2000, le=2000)]
Degrees = Annotated[float, Field(ge=-60, le=60)]
TiltPair = Annotated[list[Degrees], Field(min_length=2, max_length=2)]
TcpPort = Annotated[int, Field(ge=1, le=65535)]
Baud = Annotated[int, Field(ge=300, le=4_000_000)]
Axes = Annotated[list[Annotated[str, Field(pattern="^[+-][xyz]$")]], Field(min_length=3, max_length=3)]


RIGID_SHORE_A = 98.0  # the scale ends at 100
SCALE_MAX_N = 10.0  # by hand
SERIAL_SCALE_N, SERIAL_SCALE_HZ = 50.0, 2.0  # range and rate of a serial one, as stated


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
    baud: Baud = 115200
    rate_hz: Positive = 10.0
    is_inverted: bool = False

    def open(self) -> Reference:
        """Connect to it."""
        return TextCell(self.port, self.unit, self.full_scale_n, self.sigma_n, baud=self.baud, rate_hz=self.rate_hz,
                        is_inverted=self.is_inverted)  # fmt: skip


class _SixAxisSettings(_Section):
    """Six axes; `axes` where its own are not the pad's: which of its axes are the pad's x, y, z.

    arm_mm : the pad's centre from the reference's origin, along the pad's axes. A stage's touches tell it; loads by
        hand through a connector do not.
    """

    full_scale: Six
    sigma: Six
    axes: Axes = ["+x", "+y", "+z"]
    arm_mm: Annotated[list[Mm], Field(min_length=3, max_length=3)] = [0.0, 0.0, 0.0]
    is_inverted: bool = False

    def open(self) -> Reference:
        """Connect to it."""
        matrix = turn_of(self.axes, is_inverted=self.is_inverted)
        cell = self._cell()
        is_plain = (matrix == np.eye(3)).all() and not any(self.arm_mm)
        return cell if is_plain else Turned(cell, matrix, [1e-3 * v for v in self.arm_mm])

    def _cell(self) -> Reference:
        """The sensor in its own axes."""
        raise NotImplementedError


class NetworkSettings(_SixAxisSettings):
    """Six axes over UDP."""

    kind: Literal["network"]
    host: str
    port: TcpPort = 49152
    http_port: TcpPort = 80

    def _cell(self) -> Reference:
        settings = fetch_settings(self.host, self.http_port)
        return NetworkCell(
            self.host, np.array(self.full_scale), np.array(self.sigma), settings=settings, port=self.port
        )


class PacketSettings(_SixAxisSettings):
    """Six axes by the packets of a Sunrise box: serial with `port`, TCP with `host`."""

    kind: Literal["m8128"]
    port: str | None = None
    host: str | None = None
    baud: Baud = BAUD
    tcp_port: TcpPort = TCP_PORT
    rate_hz: Annotated[int, Field(ge=1, le=10_000)] = RATE_HZ

    @model_validator(mode="after")
    def _has_one_line(self) -> PacketSettings:
        if (self.port is None) == (self.host is None):
            raise ValueError('give either port, e.g. "/dev/ttyUSB0", or host, e.g. "192.168.0.108"')
        return self

    def _cell(self) -> Reference:
        line: ByteLine
        if self.port is not None:
            line = SerialLine(self.port, self.baud)
        else:
            assert self.host is not None
            line = TcpLine(self.host, self.tcp_port)
        return PacketCell(line, np.array(self.full_scale), np.array(self.sigma), rate_hz=self.rate_hz)


class WeightSettings(_Section):
    """Weights that a person places."""

    kind: Literal["weight"]
    sigma_g: Positive

    def open(self) -> Reference:
        """Nothing stands there yet."""
        return PlacedWeight(self.sigma_g)


class HidSettings(_Section):
    """A scale that reports over USB HID."""

    kind: Literal["hid"]
    path: str
    sigma_g: Positive = 1.0

    def open(self) -> Reference:
        """Connect to it."""
        return HidScale(self.path, self.sigma_g * force_factor("g"))


class CsvSettings(_Section):
    """What another program writes while the sensor streams: wrenches, or voltages with the matrix of a certificate."""

    kind: Literal["csv"]
    path: str
    columns: list[str] | None = None
    matrix: list[list[float]] | None = None

    @model_validator(mode="after")
    def _gauges_are_whole(self) -> CsvSettings:
        self.gauges()
        return self

    def gauges(self) -> Gauges | None:
        """Of a log of voltages; None if the log has wrenches. Raises InputError as `gauges_of`."""
        return None if self.columns is None and self.matrix is None else gauges_of(self.columns, self.matrix)

    def open(self) -> Reference:
        """It cannot be watched; raises InputError."""
        raise InputError(f"{self.path} is read when the other program has written it: use --program log")


class StageSettings(_Section):
    """A G-code machine."""

    kind: Literal["marlin", "grbl"]
    port: str
    origin_mm: Annotated[list[Mm], Field(min_length=3, max_length=3)]
    baud: Baud = 115200
    rotary_axis: Annotated[str, Field(pattern="^[ABCUVW]$")] | None = None
    rotary_origin_deg: Annotated[float, Field(ge=-3600, le=3600)] = 0.0

    def rotary(self, board: Board) -> Rotary | None:
        """What turns the board under the tip; None where it is flat.

        Raises
        ------
        InputError
            A tube that nothing turns, or a flat pad that something does.
        """
        is_tube = board.skin is not None and board.skin.shape == "tube"
        if is_tube and self.rotary_axis is None:
            raise InputError(
                f"board {board.name!r} is a tube, and this stage only moves straight: give [stage] rotary_axis, the "
                'axis in degrees that turns the tube under the tip, e.g. "A"'
            )
        if not is_tube and self.rotary_axis is not None:
            raise InputError(f"board {board.name!r} is no tube: take rotary_axis out of [stage]")
        if board.skin is None or self.rotary_axis is None:
            return None
        return Rotary(self.rotary_axis, 1e-6 * board.skin.radius_um, 1e-3 * self.origin_mm[0])

    def origin(self, board: Board) -> Place:
        """The pad's centre in the machine's coordinates, on a tube with the way round it; raises as `rotary`."""
        x_m, y_m, z_m = (1e-3 * v for v in self.origin_mm)
        rotary = self.rotary(board)
        return Place(x_m if rotary is None else rotary.way_m(self.rotary_origin_deg), y_m, z_m)

    def open(self, board: Board) -> Stage:
        """Connect to it; raises as `rotary`."""
        driver = Marlin if self.kind == "marlin" else Grbl
        return driver(self.port, baud=self.baud, rotary=self.rotary(board))


class TipSettings(_Section):
    """What touches the pad."""

    shape: Literal["sphere", "flat", "other"]
    diameter_mm: Positive


CLEAR_MM = 1.0  # between a mounted tool and a fingertip that turns below it


class IndenterSettings(_Section):
    """What a person mounts on the stage."""

    name: Annotated[str, Field(min_length=1, max_length=40)]
    shape: Literal["sphere", "flat", "square", "hexagon", "triangle", "ring", "other"]
    size_mm: Positive
    shore_a: Annotated[float, Field(gt=0, le=RIGID_SHORE_A)] = RIGID_SHORE_A

    @property
    def tool(self) -> Tool:
        """As a program mounts it."""
        return Tool(self.shape, self.size_mm / 2e3, self.shore_a, self.name)


class HolderSettings(_Section):
    """What turns a fingertip under the tip."""

    tilts_deg: Annotated[list[TiltPair], Field(min_length=1)]
    pivot_mm: Positive | None = None
    axes: Annotated[list[Annotated[str, Field(pattern="^-?[ABCUVW]$")]], Field(min_length=2, max_length=2)] | None = (
        None
    )

    def of(self, board: Board) -> Holder:
        """With this board's fingertip in it."""
        radius_mm = 5e-4 * board.pad.size_x_um
        return Holder(1e-3 * ((self.pivot_mm or radius_mm) - radius_mm), tuple(self.axes or ()))


class LimitSettings(_Section):
    """Soft limits from the pad's centre."""

    max_force_n: Positive
    half_x_mm: Positive | None = None
    half_y_mm: Positive | None = None
    top_mm: Positive | None = None
    bottom_mm: Annotated[float, Field(ge=-50, lt=0)] | None = None
    deepest_mm: Positive | None = None
    near_mm: Positive | None = None

    @property
    def limits(self) -> Limits:
        """In metres; raises InputError where one is missing that a stage needs."""
        missing = [n for n in ("half_x_mm", "half_y_mm", "top_mm", "bottom_mm", "deepest_mm") if not getattr(self, n)]
        if missing:
            raise InputError(f"the bench's file has no limits.{', limits.'.join(missing)}: a stage needs them")
        half_x_m, half_y_m, top_m, bottom_m, deepest_m, near_m = (
            1e-3 * (v if v is not None else float("inf"))
            for v in (self.half_x_mm, self.half_y_mm, self.top_mm, self.bottom_mm, self.deepest_mm, self.near_mm)
        )
        return Limits(half_x_m, half_y_m, top_m, bottom_m, deepest_m, self.max_force_n, near_m)

    @property
    def reach_m(self) -> tuple[float, float] | None:
        """How far from the centre it may touch; None where that is not said."""
        if self.half_x_mm is None or self.half_y_mm is None:
            return None
        return 1e-3 * self.half_x_mm, 1e-3 * self.half_y_mm


class RigSettings(_Section):
    """The whole file."""

    schema_: Annotated[Literal[1], Field(alias="schema")]
    reference: Annotated[
        I2cSettings | TextSettings | NetworkSettings | PacketSettings | WeightSettings | HidSettings | CsvSettings,
        Field(discriminator="kind"),
    ]
    limits: LimitSettings
    stage: StageSettings | None = None
    tip: TipSettings | None = None
    indenters: list[IndenterSettings] = []
    holder: HolderSettings | None = None

    def with_tools(self, span: Span, board: Board) -> Span:
        """Pressed with the indenters of this bench, one after the other, and at its holder's tilts.

        Raises
        ------
        InputError
            The file lists no indenter, or two of one name, or a fingertip that turns may hit the tool above it.
        """
        names = [one.name for one in self.indenters]
        if twice := {name for name in names if names.count(name) > 1}:
            raise InputError(f"two [[indenters]] are named {min(twice)!r}: a person could not tell which to mount")
        if not names:
            raise InputError(
                "program indenters presses with several shapes and sizes: list those of this bench as [[indenters]] in "
                "its file (host/ruffini/rig/README.md)"
            )
        tilts = () if self.holder is None else tuple((roll, pitch) for roll, pitch in self.holder.tilts_deg)
        if self.holder is not None:
            least_mm = 1e3 * self.holder.of(board).rise_m(tilts) + CLEAR_MM
            if (top_mm := 1e3 * self.limits.limits.top_m) < least_mm:
                raise InputError(
                    f"limits.top_mm is {top_mm:g}: the fingertip comes up by {least_mm - CLEAR_MM:.1f} mm while it "
                    f"turns: give {least_mm:.1f} mm or more"
                )
        return span._replace(tools=tuple(one.tool for one in self.indenters), tilts_deg=tilts)


def scale_rig(port: str = "") -> RigSettings:
    """A kitchen scale, without a file: read by a person, or on a port: HID, or serial that prints grams."""
    reference: WeightSettings | HidSettings | TextSettings = WeightSettings(kind="weight", sigma_g=SCALE_SIGMA_G)
    if port.startswith("/dev/hidraw"):
        reference = HidSettings(kind="hid", path=port)
    elif port:
        sigma_n, rate_hz = SCALE_SIGMA_G * force_factor("g"), SERIAL_SCALE_HZ
        reference = TextSettings(
            kind="text", port=port, unit="g", full_scale_n=SERIAL_SCALE_N, sigma_n=sigma_n, rate_hz=rate_hz
        )
    limits = LimitSettings(max_force_n=SCALE_MAX_N)
    return RigSettings.model_validate({"schema": 1, "reference": reference, "limits": limits})


def load_rig(path: Path) -> RigSettings:
    """Read a bench's file.

    Raises
    ------
    InputError
        Unreadable, or a line that is not understood; the text names it.
    """
    try:
        return RigSettings.model_validate(tomllib.loads(readable(path).read_text()))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from error
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(p) for p in first["loc"])
        raise InputError(f"{path}: {where}: {first['msg'].removeprefix('Value error, ')}") from error
