"""What counts as a touch on one unit: the noise of its linear estimate on untouched frames.

The board calls a square of 2 x 2 nodes touched where all four press harder than one number, and the strongest node
alone where it presses harder than another (firmware/solve/contact_mask.h). Both numbers are what noise reaches in one
frame of a million: the noise's covariance over the pad is measured on untouched frames, `N_DRAWN` fields are drawn with
it, and the largest of each field is followed into its tail, where ln(rate) falls with the square of the force.

Sums over larger neighbourhoods see no weaker touches: the linear estimate is smooth and its noise is alike on
neighbouring nodes, so a sum gains no more touch than noise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate import container
from ruffini.core.pipeline import Pipeline
from ruffini.errors import InputError

Array = npt.NDArray[np.float64]
Progress = Callable[[float], None]

ALLOWED_RATE = 1e-5  # false contact frames per untouched frame
SET_RATE = 1e-6  # what the numbers are set for: a tenth, for what of the noise is not Gaussian
N_DRAWN, CHUNK, SEED = 100_000, 2_000, 0
KNOWN_RATES = (1e-2, 1e-4)  # of the drawn fields, from which the tail is followed
MIN_FRAMES = 100
TOUCH_SIGMA = 12.0  # a node of an untouched frame is never this far from its median
VALID = 1  # of Validity in ruffini.proto
SECOND_PASS = ("support", "finite_strain", "relaxation", "contact")  # kinds that work on the linear estimate


@dataclass(frozen=True)
class ContactNoise:
    """Newtons: what 2 x 2 nodes and one alone hardly ever reach, and the noise of each node (n_y, n_x)."""

    square_n: float
    alone_n: float
    sigma_n: Array
    n_frames: int

    def tensors(self) -> container.Tensors:
        """The kind `contact` of proto/CALIBRATION.md."""
        values = np.ceil(np.array([self.square_n, self.alone_n]) * 1e6)
        return {"contact.noise_un": np.maximum(values, 1).astype(np.int32)}

    def report(self) -> dict[str, Any]:
        """For the manifest and the screen."""
        return {
            "frames": self.n_frames, "square_mn": round(self.square_n * 1e3, 4),
            "alone_mn": round(self.alone_n * 1e3, 4), "node_sigma_mn": round(float(np.median(self.sigma_n)) * 1e3, 4),
            "worst_node_sigma_mn": round(float(self.sigma_n.max()) * 1e3, 4), "set_false_rate": SET_RATE,
        }  # fmt: skip


def linear_pressure(board: Board, file: container.CalibrationFile, frames: Iterable[npt.NDArray[np.uint8]]) -> Array:
    """-f_z of the board's linear estimate, (n, n_y, n_x) N, of the frames after those that rest is learned from.

    Raises
    ------
    InputError
        A frame of another size, or one whose z is not measured in newtons.
    """
    kept = {k: v for k, v in file.tensors.items() if k.split(".")[0] not in SECOND_PASS}
    if not {"operator", "photometric"} <= {k.split(".")[0] for k in kept}:
        raise InputError(
            "a calibration with operator and photometric is needed: merge them with `ruffini cal file merge`"
        )
    fields = []
    with Pipeline(board, container.pack(kept, file.metadata).data) as pipeline:
        for number, frame in enumerate(frames):
            result = pipeline.process(frame)
            if not result.has_reference:
                continue
            if result.force_z_validity != VALID:
                raise InputError(
                    f"frame {number}: z is not measured there (flags {result.flags}): record the untouched pad under "
                    "its own light, with the optics that the photometric table is of"
                )
            fields.append(-pipeline.force_n()[..., 2])
    return np.array(fields)


def fit_contact_noise(pressure: Array, n_rest_frames: int, *, progress: Progress = lambda _: None) -> ContactNoise:
    """Both numbers from untouched frames.

    Parameters
    ----------
    pressure : (n, n_y, n_x) float64
        `linear_pressure`.
    n_rest_frames : int
        Frames that a rest image is the mean of: its noise is in every frame after it.

    Raises
    ------
    InputError
        Too few frames, or something touches in one.
    """
    n = len(pressure)
    if n < MIN_FRAMES:
        raise InputError(f"{n} untouched frames after those of rest: at least {MIN_FRAMES} are needed")
    middle = np.median(pressure, axis=0)
    spread = np.median(np.abs(pressure - middle), axis=0) / 0.6745  # of a Gaussian: its standard deviation
    if not (spread > 0).all():
        raise InputError("a node does not move at all from frame to frame: are these frames of a live camera?")
    far = (np.abs(pressure - middle) / spread).max(axis=(1, 2))
    if far.max() > TOUCH_SIGMA:
        raise InputError(
            f"frame {int(far.argmax())} after rest lies {far.max():.0f} standard deviations off: nothing may touch or "
            "change in this recording"
        )
    deviation = (pressure - pressure.mean(axis=0)) * np.sqrt((1 + 1 / n_rest_frames) / (n - 1))
    sigma = np.sqrt(np.square(deviation).sum(axis=0))
    largest = draw_largest(deviation, N_DRAWN, SEED, progress=progress)
    square, alone = (_tail(values) for values in largest)
    return ContactNoise(square, alone, sigma, n)


def draw_largest(
    deviation: Array, n_drawn: int, seed: int, *, progress: Progress = lambda _: None
) -> tuple[Array, Array]:
    """Gaussian fields with the covariance sum(deviation deviation^T): the largest square and node of each, N."""
    n, *shape = deviation.shape
    flat = deviation.reshape(n, -1).astype(np.float32)
    rng = np.random.default_rng(seed)
    squares, nodes = [], []
    for start in range(0, n_drawn, CHUNK):
        count = min(CHUNK, n_drawn - start)
        field = (rng.standard_normal((count, n), dtype=np.float32) @ flat).reshape(count, *shape)
        squares.append(largest_square(field))
        nodes.append(field.max(axis=(1, 2)))
        progress((start + count) / n_drawn)
    return np.concatenate(squares).astype(float), np.concatenate(nodes).astype(float)


def largest_square(pressure: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
    """The largest over 2 x 2 squares of the smallest of the four, (n,) of fields (n, n_y, n_x)."""
    rows = np.minimum(pressure[:, 1:], pressure[:, :-1])
    return np.asarray(np.minimum(rows[:, :, 1:], rows[:, :, :-1]).max(axis=(1, 2)))


def _tail(largest: Array) -> float:
    """The force that SET_RATE of the fields reach: its square grows as ln(1 / rate)."""
    squared = np.square(np.maximum(np.quantile(largest, [1 - p for p in KNOWN_RATES]), 0))
    steps = np.log(KNOWN_RATES[1] / SET_RATE) / np.log(KNOWN_RATES[0] / KNOWN_RATES[1])
    return float(np.sqrt(squared[1] + steps * (squared[1] - squared[0])))
