"""Pictures of the twin with the displacement behind them, kept between runs.

Presses are drawn like `programs.sheared_and_turned` and `programs.random_touch`, from the training's own seed; every
frame of a press is a sample. They are kept as `$XDG_CACHE_HOME/ruffini/train/<hash>/presses-00000.npz`, where the hash
covers everything that they depend on: both TOML files, the seed, the code of mechanics and pictures, the versions.
"""

from __future__ import annotations

import hashlib
import os
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ruffini import sim
from ruffini.boards import Board
from ruffini.errors import RuffiniError
from ruffini.files import write_whole
from ruffini.sim.cache import MECHANICS, cache_folder
from ruffini.sim.optics.renderer import Renderer
from ruffini.sim.programs import Rest, Touch, random_touch, sheared_and_turned
from ruffini.sim.story import play
from ruffini.sim.unit import TwinUnit
from ruffini.version import __version__

Array = npt.NDArray[np.float32]
Picture = npt.NDArray[np.uint8]
Progress = Callable[[float], None]

PRESSES_A_FILE = 20
PLAIN_SHARE = 4  # every fourth press is a `random_touch`
TOLD = ("programs", "settings", "story", "unit")  # of ruffini.sim, beside mechanics and pictures
N_REFERENCES = 8  # untouched frames that make the rest picture
WIDEST_PX = 160  # of the network's picture: larger ones are shrunk by a whole factor


@dataclass(frozen=True)
class Samples:
    """`picture` (k, h, w, 3) uint8 and the displacement of the board's nodes (k, n_y, n_x, 3), metres.

    `press` (k,) numbers the presses: frames of one press are alike and belong on one side of a split.
    """

    picture: Picture
    displacement: Array
    press: npt.NDArray[np.int64]


def shrink_factor(board: Board) -> int:
    return -(-board.camera.width_px // WIDEST_PX)


def shrunk(picture: Picture, factor: int) -> Picture:
    """The mean of factor x factor pixels; what does not fill a pixel at the right and lower border is left out."""
    import cv2

    height, width = (n // factor for n in picture.shape[:2])
    whole = picture[: height * factor, : width * factor]
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def make_samples(
    board: Board, n_presses: int, seed: int, *, progress: Progress = lambda _: None
) -> tuple[Picture, Samples]:
    """The rest picture (h, w, 3), and samples of `n_presses` presses; presses that are kept are not simulated again.

    Raises
    ------
    InputError
        The board has no twin, or is no flat pad.
    """
    unit = TwinUnit.build(board)
    renderer = unit.renderer()
    rng = np.random.default_rng([seed, 0])
    frames = [renderer.image(unit.at_rest(), rng).astype(np.float64) for _ in range(N_REFERENCES)]
    rest = shrunk(np.asarray(np.round(np.mean(frames, axis=0)), dtype=np.uint8), shrink_factor(board))
    folder = cache_folder().parent / "train" / _key(unit, seed)
    parts: list[Samples] = []
    n_files = -(-n_presses // PRESSES_A_FILE)
    for number in range(n_files):
        parts.append(_kept(folder / f"presses-{number:05d}.npz", partial(_simulated, unit, renderer, seed, number)))
        progress((number + 1) / n_files)
    whole = Samples(*(np.concatenate([getattr(p, name) for p in parts]) for name in Samples.__dataclass_fields__))
    chosen = whole.press < n_presses
    return rest, Samples(whole.picture[chosen], whole.displacement[chosen], whole.press[chosen])


def _key(unit: TwinUnit, seed: int) -> str:
    folder = Path(sim.__file__).parent
    files = [Path(__file__), *(folder / f"{name}.py" for name in (*MECHANICS, *TOLD))]
    files += sorted(file for part in ("indenters", "optics") for file in (folder / part).rglob("*.py"))
    code = b"".join(file.read_bytes() for file in files)
    told = (unit.board.text, repr(unit.twin), seed, __version__, np.__version__, PRESSES_A_FILE)
    return hashlib.sha256(repr(told).encode() + code).hexdigest()[:32]


def _drawn(board: Board, seed: int, press: int) -> Touch:
    """Press number `press`: it follows from the seed and its number alone."""
    rng = np.random.default_rng([seed, 1, press])
    if press % PLAIN_SHARE == 0:
        return random_touch(board, rng)
    return next(step for step in sheared_and_turned(board, 1, rng) if isinstance(step, Touch))


def _simulated(unit: TwinUnit, renderer: Renderer, seed: int, number: int) -> Samples:
    """The presses of one file, each followed by an untouched frame."""
    factor, first = shrink_factor(unit.board), number * PRESSES_A_FILE
    pictures, displacements, numbers = [], [], []
    for press in range(first, first + PRESSES_A_FILE):
        rng = np.random.default_rng([seed, 2, press])
        try:
            for moment in play(unit, [_drawn(unit.board, seed, press), Rest(1)]):
                pictures.append(shrunk(renderer.image(moment.displacement, rng), factor))
                displacements.append(moment.nodal_displacement().astype(np.float32))
                numbers.append(press)
        except RuffiniError:
            continue  # the contact solver gave up on it: the frames before that are good
    return Samples(np.array(pictures), np.array(displacements), np.array(numbers, dtype=np.int64))


def _kept(path: Path, make: Callable[[], Samples]) -> Samples:
    try:
        with np.load(path, allow_pickle=False) as kept:
            samples = Samples(*(kept[name] for name in Samples.__dataclass_fields__))
        os.utime(path)
        return samples
    except (OSError, ValueError, KeyError, zipfile.BadZipFile):
        pass  # not there, or not whole
    samples = make()
    file = BytesIO()
    np.savez_compressed(file, **vars(samples))
    write_whole(path, file.getvalue(), remedy="make room and run the same command again", is_durable=False)
    return samples
