"""The `operator` and `support` kinds of a calibration file, made from a board's own numbers."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from ruffini.boards import Board
from ruffini.errors import InputError
from ruffini.estimators.operator.depth_gauge import DepthGauge, fit_depth_gauge
from ruffini.estimators.operator.error_model import FITTED, ErrorModel, Estimate, error_tensors, fit_error_model
from ruffini.estimators.operator.marker_depth import MarkerDepth, fit_marker_depth
from ruffini.fem.certificate import DISPLACEMENT_LSB_NM
from ruffini.fem.compile import SHAPES, Compiled, compile_matrix, force_steps
from ruffini.fem.condense import CondensedSlab, condense, surface_stiffness
from ruffini.fem.finite_strain import LINEAR_GROWTH, FiniteStrain, error_growth, finite_strain, fitted_weights
from ruffini.fem.hierarchy import Shape
from ruffini.fem.operators import METHODS, Noise, force_operator
from ruffini.fem.slab import Slab
from ruffini.fem.support import SupportSystem, contact_mask, solve_on_support, support_system
from ruffini.fem.symmetry import Sites, node_sites
from ruffini.fem.touches import UNMEASURED
from ruffini.reflection import dense_from_blocks, spd_inverse

Tensors = dict[str, npt.NDArray[np.generic]]
Progress = Callable[[float], None]

# "support" is the optimal operator with the second pass on the contact's support.
OPERATOR_METHODS = (*METHODS, "support")
MAX_SHEAR_NOISE = 2**24  # more is no shear at all outside the modes
NORMAL_SCALE = 256  # fraction of `support.normal`'s output
FRACTION_Q14 = 1 << 14
MAX_ERROR = 1e-3  # of a program in integers, relative, on independent displacements and on touches
N_SAMPLES = 24
SCALE_Q16 = 1 << 16


class Precision(NamedTuple):
    """Relative errors that integers may cost: of the operator's and the second pass's programs, of the operator on

    touches. `operator_shapes`: hierarchies that the operator is compiled to.
    """

    programs: float = MAX_ERROR
    on_touches: float = MAX_ERROR
    operator_shapes: tuple[Shape, ...] = SHAPES


# From here on the tables exceed the processor's cache. The second pass then differs by 0.6 % of the force
# (fem/DESIGN.md). One shape: the one that costs least at the compiler's first threshold is not the one that meets the
# error on touches with the fewest entries.
MANY_NODES = 1500
MANY_NODES_PRECISION = Precision(4e-3, 1.5e-2, (Shape(128, 1, 0.5),))


def precision_of(n_nodes: int, *, has_support: bool) -> Precision:
    """For a pad with so many observed nodes; without a second pass the operator's own errors are the result's."""
    return MANY_NODES_PRECISION if has_support and n_nodes >= MANY_NODES else Precision()


LARGEST_STIFFNESS_SIGMA_1E6 = 500_000
SPREAD_SIGMAS = 4.0  # of the spread that noise of the operator's standard deviation makes
LARGEST_SPREAD = 1 << 23
# Up to here one thread: where other programs run, two wait for each other (five times the time on two busy cores).
ONE_THREAD_NODES = 1000


@dataclass(frozen=True)
class OperatorKind:
    """Tensors and metadata as proto/CALIBRATION.md has them, and the float64 matrices behind them."""

    tensors: Tensors
    metadata: dict[str, str]
    matrix: npt.NDArray[np.float64]
    support: SupportSystem | None
    beyond: FiniteStrain | None
    errors: ErrorModel | None
    marker_depth: MarkerDepth | None = None  # of boards whose depth comes from the markers
    gauge: DepthGauge | None = None  # of boards whose gauge is a table
    no_errors: str | None = None  # why no error model could be fitted, though one was asked for


class Material(NamedTuple):
    """A pad's numbers where they were measured (`ruffini cal fit --only material`) and not taken from board.toml."""

    modulus_pa: float
    poisson: float
    thickness_m: float


def board_slab(board: Board, material: Material | None = None) -> Slab:
    """The pad of a board as the operator's finite-element model."""
    pad, grid = board.pad, board.grid
    known = material or Material(float(pad.modulus_pa), pad.poisson_1e4 * 1e-4, pad.thickness_um * 1e-6)
    return Slab(
        size_x_m=pad.size_x_um * 1e-6,
        size_y_m=pad.size_y_um * 1e-6,
        thickness_m=known.thickness_m,
        n_x=grid.n_x,
        n_y=grid.n_y,
        n_layers=grid.n_layers,
        modulus_pa=known.modulus_pa,
        poisson=known.poisson,
    )


def stiffer(board: Board, material: Material | None, factor: float) -> Material:
    """The pad's numbers, by default the board's, with E times a factor."""
    slab = board_slab(board, material)
    return Material(slab.modulus_pa * factor, slab.poisson, slab.thickness_m)


def board_window_m(board: Board) -> tuple[float, float, float, float]:
    """What the camera observes: min x, min y, max x, max y from the pad's corner, metres."""
    w = board.window
    return (w.min_x_um * 1e-6, w.min_y_um * 1e-6, w.max_x_um * 1e-6, w.max_y_um * 1e-6)


def observed_unknowns(board: Board) -> npt.NDArray[np.bool_]:
    """Which of the pad's 3 n unknowns the camera sees, (3 n,) bool."""
    inside = np.zeros((board.grid.n_y, board.grid.n_x), dtype=bool)
    inside[board.observed] = True
    return np.repeat(inside.ravel(), 3)


def observed_sites(board: Board) -> Sites:
    """Where the observed nodes lie on the pad, xyz interleaved."""
    pad, grid = board.pad, board.grid
    x = np.linspace(0, pad.size_x_um * 1e-6, grid.n_x)
    y = np.linspace(0, pad.size_y_um * 1e-6, grid.n_y)
    rows, columns = board.observed
    place = np.stack(np.meshgrid(x[columns], y[rows], [0.0]), axis=-1)
    return node_sites(place.reshape(-1, 3))


def touch_samples(sites: Sites) -> npt.NDArray[np.float64]:
    """Displacements as touches make them, to judge rounding on: dents and shears of many widths, (n, N_SAMPLES)."""
    rng = np.random.default_rng(0)
    low, high = sites.place_m.min(axis=0), sites.place_m.max(axis=0)
    center = rng.uniform(low, high, (N_SAMPLES, 3))
    width = np.geomspace(0.05, 0.25, N_SAMPLES) * float(np.linalg.norm(high - low))
    size = rng.normal(0, 0.5, (N_SAMPLES, 3))
    size[:, 2] = -1
    distance2 = np.square(sites.place_m[:, None, :2] - center[None, :, :2]).sum(axis=-1)
    return np.asarray(np.exp(-distance2 / (2 * width**2)) * size[:, sites.axis].T)


def make_operator(
    board: Board,
    *,
    method: str,
    noise: Noise,
    ridge_weight: float = 1e-4,
    material: Material | None = None,
    stiffness_sigma: float | None = None,
    is_fitted: bool | None = None,
    is_finite: bool = False,
    n_touches: int = 0,
    progress: Progress = lambda _: None,
) -> OperatorKind:
    """Solve and compile the inverse FEM of a board.

    Parameters
    ----------
    stiffness_sigma : float, optional
        Relative standard deviation of the forces that the pad's numbers make of a displacement. Where left out: the
        board's for a pad that was not measured; none for a measured one, whose usual error the error model has
        (`touches.MaterialSpread`).
    is_fitted : bool, optional
        Whether the pad's numbers were measured; where left out, whether `material` is given.
    is_finite : bool
        Whether the pad is at finite strain: then the second pass adds what that makes, to second order.
    n_touches : int
        Simulated touches on which the second pass's error model is fitted; 0: none, uncertainty is not measured.
        Where they determine none (a pad that feels them too little), `no_errors` says why.

    Raises
    ------
    InputError
        Unknown method, or a matrix that the board's integers cannot hold.
    """
    if method not in OPERATOR_METHODS:
        raise InputError(f"unknown method {method!r}: choose one of {', '.join(OPERATOR_METHODS)}")
    if is_finite and method != "support":
        raise InputError(f"finite strain works on the second pass: method support, not {method}")
    slab = board_slab(board, material)
    is_fitted = material is not None if is_fitted is None else is_fitted
    with threadpool_limits(limits=1 if slab.n_nodes <= ONE_THREAD_NODES else None):
        kind = _made(board, slab, material, method, noise, ridge_weight, is_fitted, is_finite, n_touches, progress)
    if kind.support is not None:
        usual = 0.0 if is_fitted else board.pad.stiffness_sigma_1e3 * 1e-3
        sigma = usual if stiffness_sigma is None else stiffness_sigma
        kind.metadata["support.stiffness_sigma_1e6"] = str(min(round(sigma * 1e6), LARGEST_STIFFNESS_SIGMA_1E6))
    return kind


def _made(
    board: Board, slab: Slab, material: Material | None, method: str, noise: Noise, ridge_weight: float,
    is_fitted: bool, is_finite: bool, n_touches: int, progress: Progress,
) -> OperatorKind:  # fmt: skip
    has_support = method == "support"
    depth = fit_marker_depth(board, slab, noise) if board.depth.source == "markers" else None
    gauge = fit_depth_gauge(board, slab, noise) if board.depth.has_gauge_table else None
    noise = noise if depth is None else depth.noise(noise)
    noise = noise if gauge is None else replace(noise, gauge_m=gauge.gauge_m)
    matrix = force_operator(
        slab,
        "optimal" if has_support else method,
        noise=noise,
        ridge_weight=ridge_weight,
        window_m=board_window_m(board),
        progress=lambda done: progress(done * (0.5 if has_support else 0.9)),
    )
    lsb = board.field.force_lsb_un
    in_steps = matrix * force_steps(lsb)
    sites = observed_sites(board)
    room = board.calibration_bytes
    samples = touch_samples(sites)
    precision = precision_of(len(sites) // 3, has_support=has_support)
    compiled = compile_matrix(
        in_steps, sites, sites, "the operator", max_error=precision.programs, max_bytes=room, samples=samples,
        max_sample_error=precision.on_touches, shapes=precision.operator_shapes,
    )  # fmt: skip
    room -= compiled.program.n_bytes
    proof = compiled.certificate
    rows, columns = board.observed
    metadata = {
        "operator.n_x": str(columns.stop - columns.start),
        "operator.n_y": str(rows.stop - rows.start),
        "operator.force_lsb_un": str(lsb),
        "operator.displacement_lsb_nm": str(DISPLACEMENT_LSB_NM),
        "operator.method": method,
        "operator.worst_error_un": ",".join(str(math.ceil(w * lsb)) for w in proof.worst_steps),
        "operator.typical_error_1e9": ",".join(str(round(v * 1e9)) for v in proof.typical),
        "operator.material": ",".join(f"{v:.6g}" for v in material) if material else "board",
    }
    tensors: Tensors = {}
    _add(tensors, metadata, "operator", compiled)
    if depth is not None:
        room = _add_marker_depth(tensors, metadata, depth, sites, room)
    if gauge is not None:
        table, integers = gauge.tables()
        tensors |= table
        metadata |= integers
    system, beyond, errors, no_errors = None, None, None, None
    if has_support:
        condensed = condense(slab)
        system = support_system(condensed, noise, observed_unknowns(board), matrix)
        progress(0.6)
        _add_support(tensors, metadata, system, lsb, sites, room, precision.programs)
        tensors |= _spread_tensors(board, condensed, noise, lsb)
    if is_finite:
        beyond = finite_strain_of(board, slab)
        tables, integers = beyond.tensors(lsb)
        tensors |= tables
        metadata |= integers
    if system is not None and n_touches > 0:
        try:
            errors = fit_error_model(
                slab, board.observed, second_pass(board, matrix, system), noise, force_step_n=lsb * 1e-6,
                threshold_n=board.contact.threshold_un * 1e-6, n_touches=n_touches,
                observe=None if depth is None else depth.observe, spread=FITTED if is_fitted else UNMEASURED,
                progress=lambda done: progress(0.6 + 0.4 * done),
            )  # fmt: skip
            growth = error_growth(board_slab(board)) if is_finite else LINEAR_GROWTH if depth is None else None
            errors = errors if growth is None else errors.grown(growth)
            tensors |= error_tensors(errors)
        except InputError as error:
            errors, no_errors = None, str(error)
    progress(1.0)
    return OperatorKind(tensors, metadata, matrix, system, beyond, errors, depth, gauge, no_errors)


def finite_strain_of(board: Board, slab: Slab) -> FiniteStrain:
    """What a pad of this board adds at finite strain, with the board's weights whatever was fitted of this pad."""
    rows, columns = board.observed
    shape = (rows.stop - rows.start, columns.stop - columns.start)
    return finite_strain(slab, shape, fitted_weights(board_slab(board)))


def second_pass(
    board: Board, matrix: npt.NDArray[np.float64], system: SupportSystem, beyond: FiniteStrain | None = None
) -> Estimate:
    """The board's solve in float64: linear estimate with the finite-strain part, contact mask, second pass."""
    threshold_n = board.contact.threshold_un * 1e-6

    def estimate(u: npt.NDArray[np.float64]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        part = None if beyond is None else beyond.force(u).ravel()
        start = matrix @ u.ravel() if part is None else matrix @ u.ravel() + part
        force_z = start.reshape(u.shape)[..., 2]
        mask, least_n = contact_mask(force_z, threshold_n=threshold_n, min_nodes=board.contact.min_nodes)
        force = solve_on_support(system, u.ravel(), start, mask.ravel(), threshold_n=least_n, beyond_n=part)
        return force.reshape(u.shape), mask

    return estimate


def _add_marker_depth(tensors: Tensors, metadata: dict[str, str], depth: MarkerDepth, sites: Sites, room: int) -> int:
    """The room that is left."""
    is_depth = sites.axis == 2
    seen, out = (Sites(sites.place_m[keep], sites.axis[keep]) for keep in (~is_depth, is_depth))
    samples = touch_samples(sites)[~is_depth]
    compiled = compile_matrix(
        depth.matrix, out, seen, "depth from markers", max_error=MAX_ERROR, max_bytes=room, samples=samples
    )
    _add(tensors, metadata, "marker_depth", compiled)
    metadata["marker_depth.sigma_um"] = str(math.ceil(depth.sigma_m * 1e6))
    metadata["marker_depth.gauge_um"] = str(math.ceil(depth.gauge_m * 1e6))
    return room - compiled.program.n_bytes


def _add(tensors: Tensors, metadata: dict[str, str], name: str, compiled: Compiled) -> None:
    tensors |= compiled.program.tensors(name)
    metadata[f"{name}.out_shift"] = str(compiled.program.out_shift)
    metadata[f"{name}.error_1e9"] = str(round(compiled.certificate.total * 1e9))
    metadata[f"{name}.form"] = compiled.form


def _spread_tensors(board: Board, condensed: CondensedSlab, noise: Noise, force_lsb_un: int) -> Tensors:
    """How a force spreads the surface about the pad's centre, for firmware/solve/spread_check.h.

    Not where forces outside of the window spread it too.
    """
    if not observed_unknowns(board).all():
        return {}
    slab = condensed.slab
    place_um = np.zeros((slab.n_y, slab.n_x, 3))
    place_um[..., 0] = np.linspace(-0.5, 0.5, slab.n_x) * slab.size_x_m * 1e6
    place_um[..., 1] = (np.linspace(-0.5, 0.5, slab.n_y) * slab.size_y_m * 1e6)[:, None]
    steps_per_m = 1e9 / DISPLACEMENT_LSB_NM
    compliance = dense_from_blocks(condensed.bases, [spd_inverse(b) for b in surface_stiffness(condensed)])
    spread = place_um.ravel() @ compliance * (steps_per_m * force_lsb_un * 1e-6)
    limit = SPREAD_SIGMAS * noise.sigma_m[0] * steps_per_m * float(np.linalg.norm(place_um))
    if np.abs(spread).max() > LARGEST_SPREAD or limit >= 2**31:
        return {}
    return {
        "support.spread": np.round(spread).astype(np.int32),
        "support.spread_limit": np.array([max(round(limit), 1)], np.int32),
    }


def _add_support(
    tensors: Tensors, metadata: dict[str, str], system: SupportSystem, force_lsb_un: int, sites: Sites, room: int,
    max_error: float,
) -> None:  # fmt: skip
    normal = compile_matrix(
        system.normal * NORMAL_SCALE, sites, sites, "the normal equations", max_error=max_error, max_bytes=room
    )
    room -= normal.program.n_bytes
    project = compile_matrix(
        system.project * (DISPLACEMENT_LSB_NM * 1e-9 * FRACTION_Q14), sites, sites, "the projection",
        max_error=max_error, max_bytes=room,
    )  # fmt: skip
    _add(tensors, metadata, "support.normal", normal)
    _add(tensors, metadata, "support.project", project)
    scale = np.round(system.scale_n / (force_lsb_un * 1e-6) * SCALE_Q16)
    if not (scale >= 1).all() or not (scale < 2**31).all():
        raise InputError("the support's scale does not fit 32 bits: change [field] force_lsb_un")
    tensors["support.scale"] = scale.astype(np.int32)
    metadata["support.shear_noise"] = str(min(round(system.shear_noise * FRACTION_Q14), MAX_SHEAR_NOISE))
