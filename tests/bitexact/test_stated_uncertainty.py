"""What the board states of its own uncertainty against the mirror, with fitted tables and with the largest it takes."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from kept import kept
from mirror.board import Board, observed_nodes, read_board
from mirror.displacement import filled
from mirror.estimators import wrench
from mirror.field_repair import repaired_nodes
from mirror.markers import LOST, X, Y
from mirror.uncertainty import (
    LISTED,
    QUIET,
    REPORTED,
    ErrorTables,
    filled_force,
    node_sigma,
    touches_of,
    wrench_covariance,
)
from scipy.ndimage import gaussian_filter
from test_frame_path import board_with_all_stages, dent, photometric_tables
from test_stages import render

from ruffini.boards import parse_board
from ruffini.calibrate.container import CalibrationFile, base_metadata, pack
from ruffini.core import Pipeline
from ruffini.errors import InputError
from ruffini.estimators.operator.error_model import ErrorModel, error_tensors
from ruffini.estimators.operator.fit import make_operator
from ruffini.fem.operators import Noise
from ruffini.fem.uncertainty import ContactLoad, NodeError, WrenchError
from ruffini.fem.uncertainty import node_sigma as node_sigma_float
from ruffini.fem.uncertainty import wrench_covariance as wrench_covariance_float
from ruffini.wire.covariance import full_covariance

Tensors = dict[str, npt.NDArray[np.generic]]
FEW_NODES = board_with_all_stages(2)
TEXT = FEW_NODES.replace("n_x = 9\nn_y = 7", "n_x = 29\nn_y = 22")
STIFFNESS = "support.stiffness_sigma_1e6"
NEEDED = ("reported", "quiet", "local", "wrench")
NAMES = (*NEEDED, "crosstalk")
NOT_MEASURED = -32768  # any component of a node


def tables_of(text: str) -> tuple[Tensors, dict[str, str]]:
    """All but the error model."""
    typed = parse_board(text.encode(), "small")
    kind = kept(make_operator, typed, method="support", noise=Noise((5e-5, 5e-5, 2e-4)))
    tables = photometric_tables(np.random.default_rng(3))
    return {**kind.tensors, **tables}, {**base_metadata(typed), **kind.metadata}


@pytest.fixture(scope="module")
def base() -> tuple[Tensors, dict[str, str]]:
    return tables_of(TEXT)


@pytest.fixture(scope="module")
def base_of_few() -> tuple[Tensors, dict[str, str]]:
    """What the loader refuses, it refuses on a board of any size."""
    return tables_of(FEW_NODES)


def drawn(rng: np.random.Generator, *, largest: bool) -> Tensors:
    """Any tables that the loader takes; or the largest."""
    low = np.array([[100], [100], [0], [0]])
    high = np.array([[1 << 20], [1 << 24], [1 << 20], [1 << 20]])
    tables = {
        "reported": rng.integers(256, 1 << 31, (2, REPORTED)),
        "quiet": rng.integers(256, 1 << 31, (2, QUIET)),
        "local": rng.integers(0, (1 << 18) + 1, (2, 4)),
        "wrench": rng.integers(low, high + 1, (4, 2)),
        "crosstalk": rng.integers(0, (1 << 20) + 1, 1),
    }
    if largest:
        tables = {"reported": np.full((2, REPORTED), (1 << 31) - 1), "quiet": np.full((2, QUIET), (1 << 31) - 1),
                  "local": np.full((2, 4), 1 << 18), "wrench": np.repeat(high, 2, axis=1),
                  "crosstalk": np.array([1 << 20])}  # fmt: skip
    return {f"support.error_{name}": tables[name].astype(np.int32) for name in NAMES}


def expected(
    board: Board,
    tables: Tensors,
    mask: npt.NDArray[np.uint8],
    force: npt.NDArray[np.int32],
    is_filled: npt.NDArray[np.uint8] | None = None,
    stiffness_1e6: int = 0,
) -> tuple:
    tensors = (tables[f"support.error_{name}"].astype(np.int32) for name in NAMES)
    errors = ErrorTables(*tensors, stiffness_q20=(stiffness_1e6 << 20) // 10**6)
    steps = force.astype(np.int64).reshape(-1, 3)
    touches = touches_of(board, mask.astype(np.int64), steps)
    threshold = max(board["contact"]["threshold_un"] // board["field"]["force_lsb_un"], 1)
    is_filled = np.zeros(mask.shape, np.uint8) if is_filled is None else is_filled
    sigma = node_sigma(errors, steps, is_filled, mask.shape, threshold)
    of_filled = filled_force(board, steps, is_filled)
    covariance = wrench_covariance(errors, board, wrench(board, steps), touches[:LISTED], len(touches), of_filled)
    return sigma, covariance, len(touches)


def observed_shape(board: Board) -> tuple[int, int]:
    return len(observed_nodes(board, "y")), len(observed_nodes(board, "x"))


def displacements(rng: np.random.Generator, shape: tuple[int, int]) -> npt.NDArray[np.int16]:
    """Nothing, one dent, rough fields of more contacts than are listed, and noise up to the largest number."""
    y, x = np.mgrid[: shape[0], : shape[1]]

    def dent(row: float, column: float, radius: float, depth: float) -> npt.NDArray[np.float64]:
        return -depth * np.exp(-((y - row) ** 2 + (x - column) ** 2) / radius**2)

    out = [np.zeros((*shape, 3))]
    for depth in (2000.0, 8000.0, 16000.0):
        u = rng.normal(size=(*shape, 3)) * 20
        u[..., 2] += dent(shape[0] * 0.4, shape[1] * 0.6, 3.0, depth)
        out.append(u)
    u = rng.normal(size=(*shape, 3)) * 20
    for place in np.ndindex(3, 4):
        u[..., 2] += dent(shape[0] * (place[0] + 0.5) / 3, shape[1] * (place[1] + 0.5) / 4, 1.6, 6000.0)
    out.append(u)
    for size, length in ((1280, 1), (1280, 1), (2560, 0.1), (2560, 0.1), (2560, 2)):
        rough = gaussian_filter(rng.normal(size=(*shape, 3)), (length, length, 0))
        out.append(size * rough / rough.std())
    out += [rng.uniform(-32767, 32767, (*shape, 3)), 32767 * rng.choice([-1, 1], (*shape, 3))]
    fields = np.round(np.clip(out, -32767, 32767)).astype(np.int16)
    return np.concatenate([fields, [lossy(fields[2], shape)]])


def lossy(field: npt.NDArray[np.int16], shape: tuple[int, int]) -> npt.NDArray[np.int16]:
    """A dent with two nodes in it that were not measured, and one that is wrong along the surface."""
    out, row, column = field.copy(), int(shape[0] * 0.4), int(shape[1] * 0.6)
    out[row, column - 1 : column + 1] = NOT_MEASURED
    out[row + 1, column + 1, 0] += 4000
    return out


@pytest.mark.parametrize("seed", range(4))
def test_as_the_mirror_on_any_tables_and_positive_semi_definite(
    base: tuple[Tensors, dict[str, str]], seed: int
) -> None:
    typed, board = parse_board(TEXT.encode(), "small"), read_board(TEXT)
    rng = np.random.default_rng(seed)
    tables = drawn(rng, largest=seed == 0)
    stiffness_1e6 = 500_000 if seed == 0 else int(rng.integers(0, 500_001))
    file = pack({**base[0], **tables}, {**base[1], STIFFNESS: str(stiffness_1e6)})
    counts, in_contact = [], set[int]()
    with Pipeline(typed, file.data) as core:
        shape = (core.layout.node_n_y, core.layout.node_n_x)
        for u in displacements(rng, shape):
            force = core.solve(u.reshape(1, -1, 3))[0]
            sigma, covariance = core.sigma()
            is_filled = repaired_nodes(board, u.astype(np.int64))[1]
            in_contact |= set(is_filled[core.raw("mask") > 0].tolist())
            want_sigma, want_covariance, n_found = expected(
                board, tables, core.raw("mask"), force, is_filled, stiffness_1e6
            )
            assert np.array_equal(sigma.reshape(-1, 3), want_sigma)
            assert np.array_equal(covariance, want_covariance)
            assert sigma.min() >= 1
            full = full_covariance(covariance)
            scale = np.sqrt(np.outer(np.diag(full), np.diag(full)))
            assert np.linalg.eigvalsh(full / scale).min() > -1e-12
            counts.append(n_found)
    assert 0 in counts
    assert 1 in counts
    assert max(counts) > LISTED
    assert in_contact == {0, 1, 2}, "no node is filled, along the surface, with its depth"


def test_the_operator_of_an_unfitted_pad_has_the_boards_stiffness(base: tuple[Tensors, dict[str, str]]) -> None:
    assert base[1][STIFFNESS] == "100000"  # the default where board.toml states none


@pytest.mark.parametrize("stated", [None, 0, 20_000])
def test_the_boards_stiffness_counts_where_the_file_states_none(
    base: tuple[Tensors, dict[str, str]], stated: int | None
) -> None:
    text = TEXT.replace("poisson_1e4 = 4800", "poisson_1e4 = 4800\nstiffness_sigma_1e3 = 70")
    board, rng = read_board(text), np.random.default_rng(5)
    tables = drawn(rng, largest=False)
    metadata = {k: v for k, v in base[1].items() if k != STIFFNESS}
    metadata |= {} if stated is None else {STIFFNESS: str(stated)}
    u = displacements(rng, observed_shape(board))[2]
    with Pipeline(parse_board(text.encode(), "small"), pack({**base[0], **tables}, metadata).data) as core:
        force = core.solve(u.reshape(1, -1, 3))[0]
        sigma, covariance = core.sigma()
        want = expected(board, tables, core.raw("mask"), force, stiffness_1e6=70_000 if stated is None else stated)
    assert np.array_equal(sigma.reshape(-1, 3), want[0])
    assert np.array_equal(covariance, want[1])


@pytest.mark.parametrize("value", ["-1", "500001", "0.05"])
def test_a_stiffness_that_is_none_is_refused(base_of_few: tuple[Tensors, dict[str, str]], value: str) -> None:
    file = pack(
        {**base_of_few[0], **drawn(np.random.default_rng(1), largest=False)}, {**base_of_few[1], STIFFNESS: value}
    )
    with pytest.raises(InputError, match=STIFFNESS):
        Pipeline(parse_board(FEW_NODES.encode(), "small"), file.data).close()


@pytest.mark.parametrize("seed", range(2))
def test_lost_markers_under_a_contact_are_stated(base: tuple[Tensors, dict[str, str]], seed: int) -> None:
    """Of whole frames with dots missing in a contact, as the mirror says."""
    typed, board = parse_board(TEXT.encode(), "small"), read_board(TEXT)
    rng = np.random.default_rng(seed)
    tables = drawn(rng, largest=seed == 0)
    n_filled = 0
    with Pipeline(typed, pack({**base[0], **tables}, {**base[1], STIFFNESS: "0"}).data) as core:
        core.set_rest(render(board, np.random.default_rng(7), 0.0))
        for t in range(4, 10):
            lost = {7, int(rng.choice([6, 8]))} if t % 2 else set()  # 7: the middle one, in the dent
            moved = render(board, np.random.default_rng(100 + t), 0.05 * t, lost) * (1 + 4 * dent(board, t))
            frame = core.process(np.clip(np.round(moved), 0, 255).astype(np.uint8))
            assert (frame.n_markers_lost > 0) == bool(lost)  # the dent's shade may pass for one dot
            rest, _, flags = core.markers()
            rows = np.zeros((flags.size, 6), np.int64)
            rows[:, [X, Y]] = np.round(rest.reshape(-1, 2) * 65536)
            rows[:, LOST] = flags.ravel() != 0
            where = filled(board, rows)
            sigma, covariance = core.sigma()
            mask = core.raw("mask")
            want_sigma, want_covariance, _ = expected(board, tables, mask, core.raw("force"), where)
            assert np.array_equal(sigma.reshape(-1, 3), want_sigma)
            assert np.array_equal(covariance, want_covariance)
            n_filled += int((where & (mask > 0)).sum())
    assert n_filled > 3


def test_integers_follow_the_float_model(base: tuple[Tensors, dict[str, str]]) -> None:
    typed, board = parse_board(TEXT.encode(), "small"), read_board(TEXT)
    rng = np.random.default_rng(9)
    node = NodeError(rng.uniform(20, 5e4, (2, REPORTED)), rng.uniform(20, 5e4, (2, QUIET)), rng.uniform(0, 0.3, (2, 4)))
    wrench_error = WrenchError(
        np.array([2e-3, 7e-3]), np.array([8e-6, 2e-6]), np.array([20e-6, 4e-6]), np.array([0.02, 0.03]), 3e-3
    )
    tables = error_tensors(ErrorModel(node, wrench_error))
    threshold = board["contact"]["threshold_un"] / board["field"]["force_lsb_un"]
    with Pipeline(typed, pack({**base[0], **tables}, {**base[1], STIFFNESS: "60000"}).data) as core:
        for u in displacements(rng, (core.layout.node_n_y, core.layout.node_n_x))[:4]:
            force = core.solve(u.reshape(1, -1, 3))[0]
            sigma, upper = core.sigma()
            steps = force.reshape(sigma.shape)
            apart = np.abs(sigma / node_sigma_float(node, steps, threshold, 0.06) - 1)
            assert np.quantile(apart, 0.98) < 0.04  # the weight has 7 bits, which small pressures feel
            assert apart.max() < 0.3
            touches = touches_of(board, core.raw("mask").astype(np.int64), force.astype(np.int64))
            if len(touches) > LISTED:
                continue
            loads = [
                ContactLoad(1e-6 * np.array([t.x_um, t.y_um]), 1e-6 * np.array([0, 0, t.force_z_un])) for t in touches
            ]
            si = np.array(wrench(board, force.astype(np.int64))) * [*3 * [1e-6], *3 * [1e-12]]
            expected_covariance = wrench_covariance_float(wrench_error, si, loads, 0.06)
            scale = np.sqrt(np.outer(np.diag(expected_covariance), np.diag(expected_covariance)))
            np.testing.assert_allclose(full_covariance(upper) / scale, expected_covariance / scale, atol=1e-3)


def test_without_an_error_model_nothing_is_stated(base: tuple[Tensors, dict[str, str]]) -> None:
    typed = parse_board(TEXT.encode(), "small")
    with Pipeline(typed, pack(*base).data) as core:
        core.solve(np.zeros((1, core.layout.node_n_x * core.layout.node_n_y, 3), np.int16))
        with pytest.raises(InputError, match='no slot "sigma"'):
            core.sigma()


BAD = (
    ("reported", (1, 3), 255), ("reported", (0, 0), -1), ("quiet", (0, 6), 0), ("local", (1, 2), (1 << 18) + 1),
    ("local", (0, 0), -1), ("wrench", (0, 1), 99), ("wrench", (0, 0), (1 << 20) + 1), ("wrench", (1, 1), 0),
    ("wrench", (2, 0), -1), ("wrench", (3, 1), (1 << 20) + 1), ("crosstalk", (0,), -1),
    ("crosstalk", (0,), (1 << 20) + 1),
)  # fmt: skip


@pytest.mark.parametrize(("name", "at", "value"), BAD)
def test_tables_out_of_range_are_refused(
    base_of_few: tuple[Tensors, dict[str, str]], name: str, at: tuple[int, ...], value: int
) -> None:
    tables = drawn(np.random.default_rng(1), largest=False)
    tables[f"support.error_{name}"][at] = value
    with pytest.raises(InputError, match="out of range: make the operator again"):
        open_with(base_of_few, tables)


@pytest.mark.parametrize("name", NEEDED)
def test_tables_of_another_size_or_missing_are_refused(base_of_few: tuple[Tensors, dict[str, str]], name: str) -> None:
    tables = drawn(np.random.default_rng(1), largest=False)
    full = f"support.error_{name}"
    with pytest.raises(InputError, match=full):
        open_with(base_of_few, {**tables, full: tables[full][:, :-1].copy()})
    with pytest.raises(InputError, match=full):
        open_with(base_of_few, {k: v for k, v in tables.items() if k != full})


def test_a_calibration_without_crosstalk_has_none(base: tuple[Tensors, dict[str, str]]) -> None:
    name, typed = "support.error_crosstalk", parse_board(TEXT.encode(), "small")
    tables = drawn(np.random.default_rng(1), largest=False)
    found = []
    for changed in ({k: v for k, v in tables.items() if k != name}, {**tables, name: np.zeros(1, np.int32)}):
        with Pipeline(typed, pack({**base[0], **changed}, base[1]).data) as core:
            core.solve(displacements(np.random.default_rng(2), observed_shape(read_board(TEXT)))[2].reshape(1, -1, 3))
            found.append(core.sigma()[1])
    assert np.array_equal(*found)
    with pytest.raises(InputError, match=name):
        Pipeline(typed, pack({**base[0], **tables, name: np.zeros(2, np.int32)}, base[1]).data).close()


def open_with(base: tuple[Tensors, dict[str, str]], tables: Tensors) -> None:
    file: CalibrationFile = pack({**base[0], **tables}, base[1])
    Pipeline(parse_board(FEW_NODES.encode(), "small"), file.data).close()
