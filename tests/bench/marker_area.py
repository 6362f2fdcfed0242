"""Is the size of the dots worth anything beside their motion, where depth comes from the markers?

A dot's area says how the picture stretches at the dot itself, its neighbours' distance what it does on average between
them; nearer to the lens both grow. First how well an area is known: its noise on the untouched frames of a recording
(`--recording`, of `--board`), then on pictures of the twin against the truth (SIMULATED), by two ways to measure it:
    ink    the sum of 1 - I / I_0 over the dot and 2 px around it, I_0 the median of a ring outside
    fit    least squares of the rest's picture, light, contrast, motion and stretch: I = a + b T - s r . grad T + ...
    half   how much of it is darker than half of the darkest tenth, on a grid four times finer
Then what areas are worth to the depth as further rows of the observation, with the noise that the estimate takes them
to have: on states with white noise like that, and on the rendered frames with motion and areas as measured there.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.linalg as la
from scipy.interpolate import make_interp_spline
from scipy.ndimage import map_coordinates
from threadpoolctl import threadpool_limits

from ruffini.bench.states import FRESH, JUDGED, make_states
from ruffini.boards import Board, find_board
from ruffini.core import Pipeline
from ruffini.estimators.operator.fit import board_slab
from ruffini.estimators.operator.marker_depth import SEED, View, with_mirror_images
from ruffini.fem.touches import TouchMaker
from ruffini.frames import read_frames
from ruffini.sim import programs
from ruffini.sim.recording import TwinUnit, record_touches

Array = npt.NDArray[np.float64]
Rows = dict[float, tuple[float, float]]

WAYS = ("ink", "fit", "half")
NOISE_M = (5e-6, 5e-6, 20e-6)
DEPTHS_MM = (0.4, 0.8)
AREA_NOISE = (float("inf"), 0.05, 0.02, 0.01, 0.005, 0.002)  # as the estimate takes it; the first: not used
WHITE = (0.005, 0.01, 0.02)  # as it is
PRESSED = 0.2  # of the deepest marker
N_PRESSES = 16
JUDGED_SEED, DEVELOPMENT_SEED = 20_270_301, 770_001
FINER, DARKEST = 4, 0.9
MOVED_PX = 0.15  # a frame in which a marker moved this far is touched
N_TOUCHES, BATCH = 1000, 50
AROUND_PX, RING_PX = 2.0, (2.5, 4.5)  # beyond the dot's radius
LUMA = np.array([117, 601, 306]) / 1024
UNIT_M = 1e-3  # of an area's row against a length's, so that both are of a size


class DotSize:
    """Relative change of each dot's area against rest."""

    def __init__(self, rest: Array, places_px: Array, radius_px: float) -> None:
        reach = int(np.ceil(radius_px + RING_PX[1]))
        y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1].astype(float)
        away = np.hypot(x, y)
        self.ring = (away > radius_px + RING_PX[0]) & (away < radius_px + RING_PX[1])
        self.disc = away < radius_px + AROUND_PX
        self.offset = np.stack([y, x])
        fine = np.linspace(-reach, reach, FINER * 2 * reach + 1)
        self.fine = np.stack(np.meshgrid(fine, fine, indexing="ij"))
        self.fine_disc = np.hypot(*self.fine) < radius_px + AROUND_PX
        self.rest = self._windows(rest, places_px, self.offset)
        self.rest_ink, self.rest_half = self._ink(self.rest), self._half(rest, places_px, self.rest)
        along_y, along_x = np.gradient(self.rest, axis=(1, 2))
        stretch = -(x * along_x + y * along_y)
        flat = np.ones_like(self.rest)
        rows = (flat, self.rest, stretch, along_x, along_y, flat * x, flat * y)
        self.basis = np.stack([r[:, self.disc] for r in rows], axis=-1)

    def _windows(self, picture: Array, places_px: Array, offset: Array) -> Array:
        """(n, side, side) around each place, luma."""
        at = places_px[:, ::-1, None, None] + offset
        return np.asarray(map_coordinates(picture @ LUMA, at.swapaxes(0, 1), order=3, mode="nearest"))

    def _ink(self, window: Array) -> Array:
        ground = np.median(window[:, self.ring], axis=1)
        return np.asarray((1 - window[:, self.disc] / ground[:, None]).sum(axis=1))

    def _half(self, picture: Array, places_px: Array, window: Array) -> Array:
        ground = np.median(window[:, self.ring], axis=1)
        dark = 1 - self._windows(picture, places_px, self.fine)[:, self.fine_disc] / ground[:, None]
        return np.asarray((dark > np.quantile(dark, DARKEST, axis=1, keepdims=True) / 2).mean(axis=1))

    def growth(self, picture: Array, places_px: Array) -> dict[str, Array]:
        """Relative change of area by each way."""
        window = self._windows(picture, places_px, self.offset)
        seen = window[:, self.disc]
        found = np.array([la.lstsq(b, s)[0] for b, s in zip(self.basis, seen, strict=True)])
        half = self._half(picture, places_px, window) / self.rest_half
        return {"ink": self._ink(window) / self.rest_ink - 1, "fit": 2 * found[:, 2] / found[:, 1], "half": half - 1}


@dataclass(frozen=True)
class Seen:
    """What frames show: motion (frames, markers, 2) px, growth of area by each way, NaN where a dot is lost."""

    motion_px: Array
    growth: dict[str, Array]

    @classmethod
    def of(cls, board: Board, frames: Iterable[npt.NDArray[np.uint8]]) -> Seen:
        assert board.markers is not None
        radius_px = board.markers.diameter_um / 2 * board.camera.focal_mpx * 1e-3 / board.camera.standoff_um
        images = [np.asarray(f, dtype=float) for f in frames]
        rest = np.mean(images[: board.pipeline.n_rest_frames], axis=0)
        growth: dict[str, list[Array]] = {way: [] for way in WAYS}
        motion, size = [], None
        with Pipeline(board) as pipeline:
            pipeline.set_rest(rest)
            for image in images:
                pipeline.process(image.astype(np.uint8))
                rest_px, displacement, state = (v.reshape(-1, *v.shape[2:]) for v in pipeline.markers())
                if size is None:
                    size = DotSize(rest, rest_px, radius_px)
                found = size.growth(image, rest_px + displacement)
                for way in WAYS:
                    growth[way].append(np.where(state == 0, found[way], np.nan))
                motion.append(displacement)
        return cls(np.array(motion), {way: np.array(v) for way, v in growth.items()})


def rms(values: Array) -> float:
    return float(np.sqrt(np.nanmean(np.square(values))))


def of_recording(board: Board, path: Path) -> dict[str, float]:
    """Noise of the area on the untouched frames before the first motion."""
    seen = Seen.of(board, read_frames(path))
    still = np.cumsum((np.linalg.norm(seen.motion_px, axis=-1) > MOVED_PX).any(axis=1)) == 0
    return {"frames": int(still.sum())} | {way: rms(seen.growth[way][still]) for way in WAYS}


class Stretch:
    """True change of the area of each marker as the camera sees it."""

    def __init__(self, board: Board, view: View) -> None:
        x, y = (
            np.linspace(-0.5, 0.5, n) * size * 1e-6
            for n, size in ((board.grid.n_x, board.pad.size_x_um), (board.grid.n_y, board.pad.size_y_um))
        )
        self.view = view
        at_x, at_y = view.marker_m[0, :, 0], view.marker_m[:, 0, 1]
        self.x, self.y = (
            [make_interp_spline(nodes, np.eye(len(nodes)), k=3)(at, nu) for nu in (0, 1)]
            for nodes, at in ((x, at_x), (y, at_y))
        )

    def depth(self, u: Array) -> Array:
        """u_z at the markers, (k, markers)."""
        return np.asarray(np.einsum("aj,bi,kji->kab", self.y[0], self.x[0], u[..., 2]).reshape(len(u), -1))

    def of(self, u: Array) -> Array:
        """(k, markers) of displacements of the whole pad (k, rows, columns, 3): det of dp / dX, less one."""

        def at(nu_y: int, nu_x: int) -> Array:
            return np.asarray(np.einsum("aj,bi,kjic->kabc", self.y[nu_y], self.x[nu_x], u, optimize=True))

        here, nearer = at(0, 0), 1 / (self.view.standoff_m + at(0, 0)[..., 2])
        place = (self.view.marker_m + here[..., :2]) * nearer[..., None]
        columns = [
            self.view.standoff_m * nearer[..., None] * (d[..., :2] + unit - place * d[..., 2:])
            for d, unit in ((at(0, 1), [1, 0]), (at(1, 0), [0, 1]))
        ]
        (a, c), (b, d) = (np.moveaxis(v, -1, 0) for v in columns)
        return np.asarray((a * d - b * c - 1).reshape(len(u), -1))


@dataclass(frozen=True)
class Rendered:
    """Frames of the twin, and the truth of those that count: displacement and pressed nodes."""

    seen: Seen
    judged: npt.NDArray[np.bool_]
    u: Array
    force: Array

    @classmethod
    def of(cls, board: Board, seed: int) -> Rendered:
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder) / "touches"
            story = programs.sheared_and_turned(board, N_PRESSES, np.random.default_rng(seed))
            record_touches(TwinUnit.build(board), story, out, seed=seed + 1, program="sheared_and_turned")
            truth = np.load(out / "truth.npz")
            return cls(Seen.of(board, read_frames(out)), truth["judged"], truth["displacement"], truth["force"])


def of_twin(rendered: Rendered, stretch: Stretch) -> dict[str, Any]:
    """Noise at rest, and error against the truth where pressed, on rendered frames."""
    is_still = (np.abs(rendered.u) < 1e-9).all(axis=(1, 2, 3))
    true, uz = stretch.of(rendered.u), stretch.depth(rendered.u)
    judged = rendered.judged[:, None]
    pressed = judged & (uz < PRESSED * uz.min(axis=1, keepdims=True))
    growth = rendered.seen.growth
    return {
        "frames": int(judged.sum()), "true_where_pressed": rms(true[pressed]),
        **{way: {"rest": rms(growth[way][is_still]), "pressed": rms((growth[way] - true)[pressed]),
                 "elsewhere": rms((growth[way] - true)[judged & ~pressed])} for way in WAYS},
    }  # fmt: skip


class Estimates:
    """Depth at the nodes from motion, and from motion and area of one noise each."""

    def __init__(self, board: Board, stretch: Stretch) -> None:
        maker = TouchMaker(board_slab(board), SEED)
        rows, columns = board.observed
        seen, depth = [], []
        for _ in range(N_TOUCHES // BATCH):
            u = with_mirror_images(np.array([maker.draw().displacement for _ in range(BATCH)]))
            seen.append(np.hstack([stretch.view.seen(u).reshape(len(u), -1), stretch.of(u) * UNIT_M]))
            depth.append(u[:, rows, columns, 2].reshape(len(u), -1))
        features, uz = np.concatenate(seen), np.concatenate(depth)
        motion = stretch.view.noise_covariance(NOISE_M)
        n, n_motion = features.shape[1], len(motion)
        square, cross = features.T @ features / len(uz), uz.T @ features / len(uz)
        square[:n_motion, :n_motion] += motion
        self.matrix = {}
        for sigma in AREA_NOISE:
            noisy = square + np.diag(np.arange(n) >= n_motion) * (min(sigma, 1e3) * UNIT_M) ** 2
            self.matrix[sigma] = la.solve(noisy, cross.T, assume_a="pos").T

    def depth(self, sigma: float, motion: Array, area: Array) -> Array:
        """(nodes,) metres of what the nodes see and the markers' areas."""
        return np.asarray(self.matrix[sigma] @ np.concatenate([motion.ravel(), area * UNIT_M]))


def errors(board: Board, estimates: Estimates, cases: list[tuple[Array, Array, Array, Array]]) -> Rows:
    """Of each noise: error of the depth where pressed and on all of the pad, micrometres.

    `cases`: what the nodes see, areas, true displacement, true force.
    """
    threshold_n = board.contact.threshold_un * 1e-6
    out = {}
    for sigma in AREA_NOISE:
        off = [(estimates.depth(sigma, d, a) - u[board.observed][..., 2].ravel()) for d, a, u, _ in cases]
        pressed = [(f[board.observed][..., 2] < -threshold_n).ravel() for *_, f in cases]
        touched = np.concatenate([e[p] for e, p in zip(off, pressed, strict=True)])
        out[sigma] = (1e6 * rms(touched), 1e6 * rms(np.concatenate(off)))
    return out


def worth(board: Board, rendered: Rendered, stretch: Stretch, recipes: Any) -> dict[str, Rows]:
    """By where areas come from: errors of the depth by the noise that they are taken to have."""
    view, estimates, rng = stretch.view, Estimates(board, stretch), np.random.default_rng(SEED)
    out: dict[str, Rows] = {}
    states = make_states(board, recipes, DEPTHS_MM)
    for sigma in WHITE:
        cases = []
        for state in states:
            u = state.displacement[None]
            area = stretch.of(u)[0] + rng.normal(size=view.marker_m[..., 0].size) * sigma
            cases.append((view.seen(u, rng.normal(size=view.marker_m.shape) * NOISE_M[:2])[0], area, u[0], state.force))
        out[f"states, area off by {100 * sigma:.1f} %"] = errors(board, estimates, cases)
    px_m = board.camera.standoff_um * 1e-3 / board.camera.focal_mpx
    moved = rendered.seen.motion_px.reshape(-1, *view.marker_m.shape) * px_m
    at_nodes = np.einsum("aj,bi,kjic->kabc", *view.at_nodes, moved, optimize=True)
    for way, growth in (*rendered.seen.growth.items(), ("true area", stretch.of(rendered.u))):
        known = np.where(np.isnan(growth), 0.0, growth)
        cases = [(at_nodes[i], known[i], rendered.u[i], rendered.force[i]) for i in np.flatnonzero(rendered.judged)]
        out[f"rendered frames, {way}"] = errors(board, estimates, cases)
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recording", type=Path, help="untouched at first; else only the twin")
    parser.add_argument("--board", default="gelslim", help="of the twin")
    parser.add_argument("--recorded-board", default="gelsight-mini", help="of the recording")
    parser.add_argument("--development", action="store_true", help="other states than the judged ones")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    board = find_board(args.board)
    with threadpool_limits(limits=1):
        stretch = Stretch(board, View.of(board))
        rendered = Rendered.of(board, DEVELOPMENT_SEED if args.development else JUDGED_SEED)
        result: dict[str, Any] = {"twin": of_twin(rendered, stretch)}
        result["depth"] = worth(board, rendered, stretch, FRESH if args.development else JUDGED)
        if args.recording is not None:
            result["recording"] = of_recording(find_board(args.recorded_board), args.recording)
    print(json.dumps(result) if args.json else text(result, args.board))


def text(result: dict[str, Any], name: str) -> str:
    """The result as tables."""
    lines = ["relative error of a dot's area, root mean square"]
    if "recording" in result:
        noise = result["recording"]
        said = ", ".join(f"{way} {100 * noise[way]:.2f} %" for way in WAYS)
        lines.append(f"  recording, {noise['frames']} untouched frames: {said}")
    twin = result["twin"]
    true = 100 * twin["true_where_pressed"]
    lines.append(
        f"  twin of {name}, SIMULATED, {twin['frames']} frames; where pressed a dot truly grows by {true:.1f} %"
    )
    lines += [f"    {way}: " + ", ".join(f"{at} {100 * v:.2f} %" for at, v in twin[way].items()) for way in WAYS]
    lines.append(
        "depth from the markers, SIMULATED: error where pressed | on all of the pad, um; area is taken to be off by"
    )
    lines.append(" " * 32 + "".join(f"{'no area' if np.isinf(v) else f'{100 * v:.1f} %':>12}" for v in AREA_NOISE))
    for source, row in result["depth"].items():
        lines.append(f"{source:32}" + "".join(f"{a:>6.0f} |{b:>4.0f}" for a, b in row.values()))
    return "\n".join(lines)


if __name__ == "__main__":
    main()
