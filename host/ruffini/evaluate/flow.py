"""The board's texture flow beside OpenCV's dense inverse search, on textures moved by known fields (`warps`).

All methods are judged in the same run on the same pictures, at two sets of places: the centres of the board's patches,
and every pixel between them, where the board's field is the linear interpolation of its patches. A border of
`MARGIN_PX`, of which a part leaves the picture, is left out for all.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.interpolate import LinearNDInterpolator
from scipy.ndimage import map_coordinates

from ruffini.boards import Board
from ruffini.boards.pictures import picture_board
from ruffini.core import Pipeline
from ruffini.errors import InputError
from ruffini.evaluate.warps import Picture, Warp
from ruffini.tables import aligned

Array = npt.NDArray[np.float64]

FIELD_SEED = 90_174
N_FIELDS = 8
LARGEST_PX = 8.4
MARGIN_PX = 20
REPEATS = 5  # of each timed call, the median counts
PITCH_PX = 8
SIZE = (240, 320)  # of generated textures
HALF_QUALITY_PX = 0.1  # expected error of a patch of quality 128
DIS = ("ultrafast", "fast", "medium")

PX_PER_MM, STANDOFF_MM = 10.0, 20.0  # one pixel is 100 um of the lattice below
LATTICE = """[markers]
polarity = "texture"
n_x = {n_x}
n_y = {n_y}
pitch_x_um = {pitch_um}
pitch_y_um = {pitch_um}
first_x_um = 1200
first_y_um = 1200
diameter_um = 100
threshold_1e3 = 700
max_lost = 4096
"""


def board_for(picture: Picture) -> Board:
    """A board of the picture's size with a patch every 8 pixels, or wider apart in large pictures."""
    height, width = picture.shape[:2]
    pitch = max(PITCH_PX, -(-max(width, height) // 64))
    n_x, n_y = (min((n - 16) // pitch, 64) for n in (width, height))
    if min(n_x, n_y) < 2:
        raise InputError(f"a picture of {width}x{height} pixels is too small for flow: 64 x 64 are needed")
    lattice = LATTICE.format(n_x=n_x, n_y=n_y, pitch_um=round(1e3 / PX_PER_MM) * pitch)
    stages = ["difference", "markers"]
    return picture_board(picture.shape, PX_PER_MM, stages, standoff_mm=STANDOFF_MM, markers=lattice)


def speckle(rng: np.random.Generator, size: tuple[int, int] = SIZE) -> Picture:
    """Smooth random grey, correlated over 1.5 pixels."""
    import cv2

    noise = np.asarray(cv2.GaussianBlur(rng.normal(0, 1, size), (0, 0), 1.5))
    grey = np.clip(110 + 35 * noise / noise.std(), 0, 255).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)


def glitter(rng: np.random.Generator, size: tuple[int, int] = SIZE) -> Picture:
    """Coloured flakes of 1.6 to 3.6 pixels on grey, one on 51 pixels."""
    import cv2

    height, width = size
    picture = np.full((*size, 3), 90.0)
    for _ in range(height * width // 51):
        place = [round(16 * v) for v in (rng.uniform(0, width), rng.uniform(0, height))]
        colour = rng.uniform(40, 230, 3).tolist()
        cv2.circle(picture, place, round(16 * rng.uniform(0.8, 1.8)), colour, -1, cv2.LINE_AA, 4)
    return np.asarray(np.clip(cv2.GaussianBlur(picture, (0, 0), 0.7), 0, 255), dtype=np.uint8)


@dataclass
class Errors:
    """Of one method over all fields: lengths of the error at patches and at all pixels, milliseconds."""

    at_patches: list[Array]
    dense: list[Array]
    ms: list[float]

    def row(self) -> dict[str, float]:
        """For --json."""
        patches, dense = np.concatenate(self.at_patches), np.concatenate(self.dense)
        return {
            "rms_px": float(np.sqrt((patches**2).mean())), "worst_px": float(patches.max()),
            "dense_rms_px": float(np.sqrt((dense**2).mean())), "ms": float(np.median(self.ms)),
        }  # fmt: skip


def graded(quality: Array, error: Array) -> dict[str, float]:
    """Whether quality foretells the error of the patches, px RMS: what it states, of all and of its best and worst

    quarter what it was; and Spearman's correlation of quality and error.
    """
    order = np.argsort(quality, kind="stable")
    quarter = max(len(order) // 4, 1)
    ranks = [np.argsort(np.argsort(v, kind="stable")) for v in (quality, error)]
    expected2 = HALF_QUALITY_PX**2 * (255 / quality - 1)

    def rms(values: Array) -> float:
        return float(np.sqrt(np.square(values).mean()))

    return {
        "stated_px": float(np.sqrt(expected2.mean())), "rms_px": rms(error),
        "best_quarter_px": rms(error[order[-quarter:]]),
        "worst_quarter_px": rms(error[order[:quarter]]),
        "rank_correlation": float(np.corrcoef(ranks[0], ranks[1])[0, 1]),
    }  # fmt: skip


def _dis(preset: str, still: Picture, moved: Picture) -> tuple[Array, float]:
    """OpenCV's dense flow (h, w, 2), and the median milliseconds of a call on one thread, grey pictures given."""
    import cv2

    cv2.setNumThreads(1)
    module: Any = cv2  # its stubs lack the method
    method = module.DISOpticalFlow_create(getattr(cv2, f"DISOPTICAL_FLOW_PRESET_{preset.upper()}"))
    first, second = (cv2.cvtColor(p, cv2.COLOR_BGR2GRAY) for p in (still, moved))
    method.calc(first, second, None)  # the first call makes its buffers
    spent = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        flow = method.calc(first, second, None)
        spent.append((time.perf_counter() - start) * 1e3)
    return np.asarray(flow, dtype=float), float(np.median(spent))


def _at(field: Array, places: Array) -> Array:
    """A dense field (h, w, 2) at (n, 2) places, bilinear."""
    return np.stack([map_coordinates(field[..., c], [places[:, 1], places[:, 0]], order=1) for c in (0, 1)], axis=1)


def judge(
    still_of: Callable[[int], Picture], n_fields: int, board: Board | None, progress: Callable[[float], None]
) -> dict[str, Any]:
    """Errors and times of all methods; `still_of` gives the texture of each field."""
    errors = {name: Errors([], [], []) for name in ("ruffini", *DIS)}
    n_lost, n_patches, largest = 0, 0, 0.0
    qualities: list[Array] = []
    for number in range(n_fields):
        still = still_of(number)
        height, width = still.shape[:2]
        rng = np.random.default_rng([FIELD_SEED, number])
        warp = Warp.random(rng, (width, height), LARGEST_PX)
        moved = warp.render(still, rng)
        y, x = np.mgrid[MARGIN_PX : height - MARGIN_PX, MARGIN_PX : width - MARGIN_PX].astype(float)
        pixels = np.column_stack([x.ravel(), y.ravel()])
        truth = warp.forward(pixels)
        largest = max(largest, float(np.linalg.norm(truth, axis=1).max()))
        places, found, quality, spent = followed(board or board_for(still), still, moved)
        lost = quality == 0
        inner = ((places >= MARGIN_PX) & (places < np.array([width, height]) - MARGIN_PX)).all(axis=1)
        n_lost, n_patches = n_lost + int((lost & inner).sum()), n_patches + int(inner.sum())
        seen = inner & ~lost
        if not seen.any():
            raise InputError("no patch of the picture has texture enough to be followed: is this the textured side?")
        aim = warp.forward(places[seen])
        dense = LinearNDInterpolator(places, found)(pixels)
        held = np.isfinite(dense).all(axis=1)
        ours = errors["ruffini"]
        ours.at_patches.append(np.linalg.norm(found[seen] - aim, axis=1))
        ours.dense.append(np.linalg.norm(dense[held] - truth[held], axis=1))
        ours.ms.append(spent)
        qualities.append(quality[seen])
        for name in DIS:
            flow, peer_ms = _dis(name, still, moved)
            errors[name].at_patches.append(np.linalg.norm(_at(flow, places[seen]) - aim, axis=1))
            errors[name].dense.append(np.linalg.norm(_at(flow, pixels[held]) - truth[held], axis=1))
            errors[name].ms.append(peer_ms)
        progress((number + 1) / n_fields)
    quality_row = graded(np.concatenate(qualities), np.concatenate(errors["ruffini"].at_patches))
    counts = {"fields": n_fields, "patches": n_patches // n_fields, "lost": n_lost / n_fields}
    rows = {name: e.row() for name, e in errors.items()}
    return {**counts, "largest_px": largest, "quality": quality_row, **rows}


def followed(board: Board, still: Picture, moved: Picture) -> tuple[Array, Array, Array, float]:
    """Places, displacements (n, 2) px, qualities (0: lost), and the median milliseconds of the stage."""
    spent = []
    with Pipeline(board) as pipeline:
        pipeline.set_rest(still)
        for _ in range(REPEATS):
            spent.append(pipeline.process(moved).stage_ns["markers"] * 1e-6)
        rest, displacement, _ = pipeline.markers()
        quality = pipeline.marker_quality().ravel().astype(float)
    return rest.reshape(-1, 2), displacement.reshape(-1, 2), quality, float(np.median(spent))


def check(picture: Picture, board: Board | None) -> None:
    """Refuse what no flow can be judged on.

    Raises
    ------
    InputError
        The board's lattice is not of a texture, or the picture has another size than the board.
    """
    if board is None:
        board_for(picture)
        return
    if board.markers is None or board.markers.polarity != "texture" or not board.writes("markers"):
        raise InputError(f'board {board.name!r} follows no texture: markers.polarity = "texture" would say so')
    height, width = picture.shape[:2]
    if (width, height) != (board.camera.width_px, board.camera.height_px):
        raise InputError(f"the picture is {width}x{height}, board {board.name!r} needs {board.resolution}")


def evaluate(
    picture: Picture | None,
    board: Board | None,
    *,
    n_fields: int = N_FIELDS,
    progress: Callable[[float], None] = lambda _: None,
) -> dict[str, Any]:
    """Judge on a picture, or on generated speckle and glitter, which are others for each field."""
    if picture is not None:
        check(picture, board)
        still = picture
        return {"textures": {"picture": judge(lambda _: still, n_fields, board, progress)}}
    size = SIZE if board is None else (board.camera.height_px, board.camera.width_px)
    textures = {}
    for index, make in enumerate((speckle, glitter)):
        still_of = partial(_generated, make, size)
        check(still_of(0), board)
        textures[make.__name__] = judge(still_of, n_fields, board, partial(_share, progress, index))
    return {"textures": textures}


def _generated(make: Callable[..., Picture], size: tuple[int, int], number: int) -> Picture:
    return make(np.random.default_rng([FIELD_SEED, 1, number]), size)


def _share(progress: Callable[[float], None], index: int, done: float) -> None:
    progress((index + done) / 2)


def table(result: dict[str, Any]) -> str:
    """The result as text."""
    lines = []
    for texture, row in result["textures"].items():
        lines.append(
            f"{texture}: {row['fields']} fields, up to {row['largest_px']:.1f} px; {row['patches']} patches, "
            f"{row['lost']:.1f} lost or without texture"
        )
        q = row["quality"]
        lines.append(
            f"quality of patches states {q['stated_px']:.4f} px RMS; of its best quarter the error is "
            f"{q['best_quarter_px']:.4f}, of its worst {q['worst_quarter_px']:.4f}; rank correlation with the error "
            f"{q['rank_correlation']:.2f}"
        )
        lines += aligned(("", "at patches, RMS px", "worst px", "all pixels, RMS px", "median ms"), [
            (
                name if name == "ruffini" else f"OpenCV DIS {name}",
                *(f"{row[name][key]:.4f}" for key in ("rms_px", "worst_px", "dense_rms_px")), f"{row[name]['ms']:.3f}",
            )
            for name in ("ruffini", *DIS)
        ])  # fmt: skip
    return "\n".join(lines)
