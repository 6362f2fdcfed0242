"""What `ruffini live` starts: the source of frames, the store of this unit, and what it cannot measure yet."""

from __future__ import annotations

import contextlib
import re
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from ruffini.boards import Board, board_names, find_board
from ruffini.daemon import Daemon, started_daemon
from ruffini.errors import InputError, NoDeviceError
from ruffini.frames import read_frames
from ruffini.live.cameras import (
    LocalCamera,
    boards_of_camera,
    boards_of_size,
    choose_camera,
    local_cameras,
    the_one,
)
from ruffini.live.folders import CALIBRATIONS, unit_folder
from ruffini.live.recording_server import RecordingServer

MAX_SERIAL_BYTES = 31  # ruffinid's --serial


class Source(NamedTuple):
    """Where frames come from: ruffinid's --camera or a recording, options, a name for a person, what tells the unit."""

    camera: str | Path
    options: tuple[str, ...]
    text: str
    key: str


def of_camera(camera: LocalCamera) -> Source:
    """Frames as they come."""
    serial = re.sub(r"[^!-~]", "", camera.serial)
    is_usable = serial == camera.serial and 0 < len(serial) <= MAX_SERIAL_BYTES
    return Source(f"v4l2:{camera.path}", ("--serial", serial) if is_usable else (), camera.text, camera.key)


def of_recording(path: Path) -> Source:
    """A video or a folder of pictures, again and again; the stream is marked as a replay."""
    return Source(path, ("--loop",), str(path), f"recording-{path.resolve().stem}")


def choose(
    camera: str | Path | None, board_name: str | Path | None, pick: Callable[[Sequence[Board], str], Board] = the_one
) -> tuple[Source, Board]:
    """Where frames come from, and the board that they are of.

    Parameters
    ----------
    camera : a camera's path, serial number or a part of its name, a video, or a folder of pictures; None: the only
        camera.
    board_name : name of a board, or a folder with a board.toml; None: by USB identity or picture size.
    pick : of boards that fit, and what they fit.

    Raises
    ------
    RuffiniError
        No or several cameras or boards fit.
    """

    def all_boards() -> list[Board]:
        return [find_board(name) for name in board_names()]

    board = find_board(board_name) if board_name else None
    if camera and (Path(camera).is_file() or Path(camera).is_dir()):  # a device is neither
        if board is None:
            size = picture_size(Path(camera))
            board = pick(boards_of_size(all_boards(), *size), f"{camera} ({size[0]}x{size[1]})")
        return of_recording(Path(camera)), board
    chosen = choose_camera(local_cameras(), None if camera is None else str(camera))
    return of_camera(chosen), board or pick(boards_of_camera(all_boards(), chosen), chosen.text)


@contextlib.contextmanager
def local_camera(camera: str | Path | None = None, board: str | Path | None = None) -> Iterator[str]:
    """Run the firmware on a camera at this computer while the block lasts; its port, for `ruffini.connect`.

    Parameters
    ----------
    camera, board : as of `choose`. The calibration is this unit's: the one that `ruffini live` and `ruffini --camera`
        flash.

    Raises
    ------
    RuffiniError
        No or several cameras or boards fit, or ruffinid does not start, or it ended meanwhile.

    Examples
    --------
    >>> import ruffini
    >>> with ruffini.local_camera("DIGIT") as port, ruffini.connect(port) as sensor:  # doctest: +SKIP
    ...     print(next(frame.wrench.force for frame in sensor.frames() if frame.is_valid))
    """
    source, its_board = choose(camera, board)
    with running_unit(source, its_board) as daemon:
        try:
            yield daemon.port
        except NoDeviceError as error:  # of its host: the daemon knows why
            if daemon.has_ended() and (said := daemon.problem()):
                raise NoDeviceError(said) from error
            raise


def picture_size(path: Path) -> tuple[int, int]:
    """Width and height of a recording's first picture.

    Raises
    ------
    InputError
        It holds no picture that can be read.
    """
    height, width = next(iter(read_frames(path))).shape[:2]
    return width, height


def store_folder(board: Board, key: str) -> Path:
    """Where ruffinid keeps this unit's calibration."""
    return unit_folder("live", board.name, key)


def calibrations_folder(board: Board, key: str) -> Path:
    """Where the presses and files of this unit's calibrations from the page are kept."""
    return unit_folder(CALIBRATIONS, board.name, key)


@contextlib.contextmanager
def running_unit(source: Source, board: Board) -> Iterator[Daemon]:
    """ruffinid on the source with the unit's own store, until the block is left.

    Raises
    ------
    RuffiniError
        It does not start; class and text are by its exit code and its own words.
    """
    assert board.folder is not None
    store = store_folder(board, source.key)
    store.mkdir(parents=True, exist_ok=True)
    with contextlib.ExitStack() as stack:
        camera = source.camera
        if isinstance(camera, Path):
            socket = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="ruffini-"))) / "frames"
            stack.enter_context(RecordingServer(board, socket, camera))
            camera = f"frames:{socket}"
        yield stack.enter_context(started_daemon(board.folder, camera, store, *source.options))


def what_is_missing(board: Board, calibration: Any) -> str:
    """One sentence on what a unit shows and what it cannot tell; `calibration` is HELLO's of it."""
    shown = ["the picture"]
    if board.markers is not None:
        shown.append("the motion of its markers in millimetres")
    never = f"; this board never measures {', '.join(board.board.not_measured)}" if board.board.not_measured else ""
    if not calibration.present:
        from ruffini.estimators.table import how_calibrated  # the fits take a second to import

        try:
            until = f", no newtons until it is calibrated {how_calibrated(board)}"
        except InputError as error:
            until = f"; {error}"
        return f"not calibrated: shows {' and '.join(shown)}{until}{never}"
    return f"calibrated ({', '.join(calibration.kinds)}, {calibration.created_utc}){never}"
