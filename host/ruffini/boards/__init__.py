"""board.toml as typed settings, read by the firmware's own parser."""

from __future__ import annotations

import ctypes
import os
from pathlib import Path

from pydantic import Field

from ruffini.boards.sections import (
    BoardIdentity,
    Camera,
    Contact,
    Depth,
    Eeprom,
    Exposure,
    FieldSettings,
    Grid,
    Learned,
    LedDriver,
    Light,
    Markers,
    Memory,
    Pad,
    Pipeline,
    Reflex,
    Section,
    Skin,
    Stereo,
    Targets,
    Temperature,
    Threads,
    Window,
)
from ruffini.errors import InputError
from ruffini.files import readable
from ruffini.native import library

__all__ = [
    "Board", "Markers", "Pad", "Section", "Skin",
    "board_names", "boards_folder", "find_board", "observed_range", "parse_board",
]  # fmt: skip


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


def parse_board(text: str | bytes, where: str) -> Board:
    """Board of a board.toml's text; `where` names the file in messages.

    Raises
    ------
    InputError
        The parser refuses the file; its sentence says what, where and what to do.
    RuffiniError
        libruffini is missing.
    """
    raw = text.encode() if isinstance(text, str) else text
    core = library()
    json = core.ruffini_board_json(raw, ctypes.c_size_t(len(raw)), os.fsencode(where))
    if json is None:
        raise InputError(os.fsdecode(core.ruffini_error()))
    board = Board.model_validate_json(json)
    object.__setattr__(board, "_text", raw.decode())
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
