"""How deep each patch of a texture is pressed: kind `contact_depth` of proto/CALIBRATION.md.

firmware/stages/contact_depth/contact_depth.h has the equations. Two steps, each fitted on presses whose log knows
the gel's surface, which a twin's does (SIMULATED) and a bench's does not:

    linear   the best linear estimate of u_z from the flow (ridge), the same for a press and its mirror images
    net      a perceptron of what that says about a patch, of the density there and of what the contact model sees; of
             each frame some patches that touch and some that do not

How far off it is gets measured on presses that were left out: sizes of those that only go down, and every other one
of those that are moved sideways, so that the fit never lacks either.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate.container import Tensors
from ruffini.estimators.contact_model.fit import INPUT_STEP, seen_of
from ruffini.estimators.contact_model.flow import fall_of, flow_um, patch_places, smoothed
from ruffini.estimators.contact_model.log import Press
from ruffini.estimators.contact_model.perceptron import Perceptron
from ruffini.estimators.contact_model.wrench import ContactWrench, fit_contact_wrench
from ruffini.fem.compile import compile_matrix
from ruffini.fem.symmetry import Sites

Array = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]
Places = npt.NDArray[np.intp]

NOISE_UM = 17.0  # of the flow, that the linear estimate reckons with: patches overlap and err alike
FEW_TIMES, MANY_TIMES = 2, 8  # of smoothing by (1 2 1)
PATCH_STEP = np.array([2.0**-10] * 4 + [2.0**-8, 1e-3])  # over the profile's size; mm
DEPTH_STEP = np.array([2.0**-12])
N_UNITS, DECAY = 16, 1e-5
MOST_FRAMES = 10  # of a press
N_UNDER, N_BESIDE = 20, 12  # patches of a frame
MOST_ROWS = 60_000
MAX_ERROR = 1e-3  # of the linear estimate's 15 bits


@dataclass(frozen=True)
class DepthMap:
    """`linear` (n, 2 n) from a flow to a first depth of each patch, without unit; `net` of (24,) inputs."""

    linear: Array
    net: Perceptron

    def __call__(self, board: Board, frame: Frame) -> Array:
        """Depth of each patch (n,), mm."""
        ratio = self.net(inputs_of_patches(board, self.linear, frame))[:, 0]
        return np.asarray(ratio * frame.size_um * 1e-3)


@dataclass(frozen=True)
class Frame:
    """flow (n_y, n_x, 2), profile size and middle (2,) from the pad's centre, um; inputs (18,) of the contact model."""

    flow_um: Array
    size_um: float
    middle_um: Array
    model: Array


@dataclass(frozen=True)
class JudgedMap:
    """A map of all presses, and what maps of others err by on presses left out: RMS in mm by shape and "all".

    `under` where a patch touches, `beside` elsewhere.
    """

    map: DepthMap
    under: dict[str, float]
    beside: dict[str, float]

    def report(self) -> dict[str, dict[str, float]]:
        """For JSON."""
        return {"under_mm": self.under, "beside_mm": self.beside}


def fit_contact_depth(
    board: Board, presses: list[Press], folds: Sequence[Callable[[Press], bool]], progress: Callable[[float], None]
) -> JudgedMap | None:
    """Fit and judge; None where no press knows the gel's surface, or none can be left out."""
    known = [p for p in presses if p.surface_mm is not None]
    if not known:
        return None
    off: list[tuple[str, tuple[Array, Array]]] = []
    sideways = [p.name for p in known if not p.goes_down][::2]
    left_out = [{p.name for p in known if p.goes_down and is_left(p)} for is_left in folds] + [set(sideways)]
    for done, names in enumerate(left_out, 1):
        rest = [p for p in known if p.name not in names]
        if rest and names:
            part, wrench = _fitted(board, rest)
            off += [(p.shape, _errors(board, part, p, wrench)) for p in known if p.name in names]
        progress(done / (len(left_out) + 1))
    if not off:
        return None
    shapes = [*dict.fromkeys(shape for shape, _ in off), "all"]
    under, beside = (
        {s: _rms([errors[k] for shape, errors in off if s in (shape, "all")]) for s in shapes} for k in (0, 1)
    )
    return JudgedMap(_fitted(board, known)[0], under, beside)


def _fitted(board: Board, presses: list[Press]) -> tuple[DepthMap, ContactWrench]:
    wrench = fit_contact_wrench(board, presses)
    linear = fit_linear(board, presses)
    rng = np.random.default_rng(0)
    inputs, ratio, size = [], [], []
    for press in presses:
        frames = list(frames_of(board, press, wrench))
        for i in rng.permutation(len(frames))[:MOST_FRAMES]:
            at, frame = frames[i]
            chosen = np.concatenate([_some(rng, _under(press)[at], N_UNDER), _some(rng, ~_under(press)[at], N_BESIDE)])
            inputs.append(inputs_of_patches(board, linear, frame)[chosen])
            ratio.append(_surface_mm(press)[at][chosen] * 1e3 / frame.size_um)
            size.append(np.full(len(chosen), frame.size_um))
    x, y, weights = np.concatenate(inputs), np.concatenate(ratio), np.concatenate(size)
    rows = rng.permutation(len(x))[:MOST_ROWS]
    net = Perceptron.fit(x[rows], y[rows, None], weights=weights[rows, None], n_units=N_UNITS,
                         n_directions=x.shape[1], decay=DECAY)  # fmt: skip
    return DepthMap(linear, net), wrench


def _surface_mm(press: Press) -> Array:
    assert press.surface_mm is not None
    return press.surface_mm


def _under(press: Press) -> Bools:
    assert press.under is not None
    return press.under


def _some(rng: np.random.Generator, which: Bools, n: int) -> Places:
    return np.asarray(rng.permutation(np.flatnonzero(which))[:n])


def frames_of(board: Board, press: Press, wrench: ContactWrench) -> Iterator[tuple[int, Frame]]:
    """Each frame of a press that says anything, with its number."""
    seen = seen_of(press, -wrench(press.flow)[:, 2])
    for row, at in enumerate(seen.frame):
        yield int(at), Frame(flow_um(board, press.flow[at]), press.size[at] / 16, press.center_um[at], seen.x[row])


def fit_linear(board: Board, presses: list[Press]) -> Array:
    """D of u_z = D u over all frames and their mirror images, ridge of NOISE_UM."""
    assert board.markers is not None
    shape = (board.markers.n_y, board.markers.n_x)
    n = shape[0] * shape[1]
    square, cross, n_frames = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, n)), 0
    for press in presses:
        good = press.is_good & np.array([_under(press)[at].any() for at in range(len(press.flow))])
        u = np.array([flow_um(board, flow).ravel() for flow in press.flow[good]]).reshape(-1, 2 * n)
        z = np.array([1e3 * _surface_mm(press)[at] for at in np.flatnonzero(good)]).reshape(-1, n)
        square += u.T @ u
        cross += u.T @ z
        n_frames += len(u)
    for axis in (1, 0):
        image, sign, of_depth = _mirrored(shape, axis)
        square = (square + sign[:, None] * square[np.ix_(image, image)] * sign) / 2
        cross = (cross + sign[:, None] * cross[np.ix_(image, of_depth)]) / 2
    return np.asarray(np.linalg.solve(square / n_frames + NOISE_UM**2 * np.eye(2 * n), cross / n_frames).T)


def _mirrored(shape: tuple[int, int], axis: int) -> tuple[Places, Array, Places]:
    """Where each number of a flow comes from in a mirror, with which sign, and where each depth comes from."""
    at = np.flip(np.arange(shape[0] * shape[1]).reshape(shape), axis).ravel()
    image = np.column_stack([2 * at, 2 * at + 1]).ravel()
    sign = np.tile([-1.0, 1.0] if axis == 1 else [1.0, -1.0], len(at))
    return image, sign, at


def inputs_of_patches(board: Board, linear: Array, frame: Frame) -> Array:
    """(n, 24) as the board makes them."""
    first = (linear @ frame.flow_um.ravel()).reshape(frame.flow_um.shape[:2])
    few = smoothed(first, FEW_TIMES)
    many = smoothed(few, MANY_TIMES - FEW_TIMES)
    x, y = patch_places(board)
    away = np.hypot(x[None, :] - frame.middle_um[0], y[:, None] - frame.middle_um[1])
    own = [first / frame.size_um, few / frame.size_um, many / frame.size_um,
           np.full_like(first, first.max() / frame.size_um),
           65536 * fall_of(board, frame.flow_um) / (16 * frame.size_um), away * 1e-3]  # fmt: skip
    patches = np.stack(own, axis=-1).reshape(-1, len(own))
    return np.column_stack([patches, np.tile(frame.model, (len(patches), 1))])


def _errors(board: Board, part: DepthMap, press: Press, wrench: ContactWrench) -> tuple[Array, Array]:
    """Of all frames, mm: where a patch touches, and elsewhere."""
    under, beside = [np.zeros(0)], [np.zeros(0)]
    for at, frame in frames_of(board, press, wrench):
        off = part(board, frame) - _surface_mm(press)[at]
        touches = _under(press)[at]
        under.append(off[touches])
        beside.append(off[~touches])
    return np.concatenate(under), np.concatenate(beside)


def _rms(parts: list[Array]) -> float:
    return float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))


def depth_tables(board: Board, judged: JudgedMap, presses: list[Press]) -> tuple[Tensors, dict[str, str]]:
    """Tensors and metadata of the kind."""
    m = board.markers
    assert m is not None
    y, x = np.meshgrid(np.arange(m.n_y) * m.pitch_y_um, np.arange(m.n_x) * m.pitch_x_um, indexing="ij")
    place = np.asarray(np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]) * 1e-6, dtype=np.float64)
    n = len(place)
    flows = np.array([flow_um(board, p.flow[-1]).ravel() for p in presses]).T
    compiled = compile_matrix(
        judged.map.linear, Sites(place, np.full(n, 2)), Sites(np.repeat(place, 2, axis=0), np.tile([0, 1], n)),
        "depth from the flow", max_error=MAX_ERROR, max_bytes=board.calibration_bytes, samples=flows,
    )  # fmt: skip
    tensors = compiled.program.tensors("contact_depth.linear")
    tensors |= judged.map.net.tables("contact_depth.net", np.concatenate([PATCH_STEP, INPUT_STEP]), DEPTH_STEP)
    return tensors, {
        "contact_depth.linear.out_shift": str(compiled.program.out_shift),
        "contact_depth.linear.error_1e9": str(round(compiled.certificate.total * 1e9)),
        "contact_depth.linear.form": compiled.form,
        "contact_depth.sigma_um": str(max(1, round(1e3 * judged.under["all"]))),
    }
