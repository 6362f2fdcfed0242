"""The material fit finds the numbers of a pad that differs from the board's, and says when a log cannot tell them."""

from __future__ import annotations

import functools
import json
from pathlib import Path

import numpy as np
import pytest
from kept import kept

from ruffini.boards import Board, find_board, parse_board
from ruffini.calibrate.log.reference import read_wrench_csv, write_fit
from ruffini.errors import InputError
from ruffini.estimators.material.fit import (
    MaterialFit,
    fit_material,
    log_from_frames,
    other_strain,
    read_material,
    read_stiffness_sigma,
)
from ruffini.estimators.material.model import MaterialLog
from ruffini.estimators.material.prior import (
    Prior,
    board_prior,
    fleet_prior,
    next_gel_prior,
    read_prior,
    strain_remark,
    write_prior,
)
from ruffini.estimators.operator.fit import Material, board_slab, finite_strain_of
from ruffini.fem.condense import condense, surface_stiffness
from ruffini.fem.finite_strain import EXACT, finite_strain, fitted_weights
from ruffini.fem.operators import Noise
from ruffini.fem.slab import Slab
from ruffini.reflection import dense_from_blocks, spd_inverse

NOISE = Noise((5e-6, 5e-6, 20e-6))
TOUCH_NOISE_M = 2e-6
TRUE = Material(215_000.0, 0.470, 4.15e-3)


@pytest.fixture(scope="module")
def board() -> Board:
    text = (Path(__file__).parents[2] / "data" / "boards" / "base.toml").read_text()
    text = text.replace("n_x = 31\nn_y = 25\nn_layers = 6", "n_x = 21\nn_y = 17\nn_layers = 4")
    return parse_board(text, "test")


@functools.cache
def compliance_of(slab: Slab) -> np.ndarray:
    condensed = condense(slab)
    return dense_from_blocks(condensed.bases, [spd_inverse(b) for b in surface_stiffness(condensed)])


def touches(
    board: Board, n: int, rng: np.random.Generator, *, is_finite: bool = False, pad: Material = TRUE
) -> tuple[np.ndarray, np.ndarray]:
    """Displacement and wrench of n touches of four frames each, with an untouched frame before each."""
    slab = board_slab(board, pad)
    compliance = compliance_of(slab)
    law = finite_strain(slab, (slab.n_y, slab.n_x), EXACT)

    def pressed(force: np.ndarray) -> np.ndarray:
        """u of F = K u, or of F = K u + Q(u) to second order."""
        u = compliance @ force.ravel()
        if is_finite:
            u = u - compliance @ law.force(u.reshape(slab.n_y, slab.n_x, 3)).ravel()
        return u.reshape(-1, 3)

    x = np.linspace(-0.5, 0.5, slab.n_x) * slab.size_x_m
    y = np.linspace(-0.5, 0.5, slab.n_y) * slab.size_y_m
    grid = np.stack(np.meshgrid(x, y), axis=-1)
    arms = np.concatenate([grid, np.zeros((*grid.shape[:2], 1))], axis=-1).reshape(-1, 3)
    displacement, wrench = [np.zeros((slab.n_nodes, 3))], [np.zeros(6)]
    for _ in range(n):
        center, radius = rng.uniform([-5e-3, -4e-3], [5e-3, 4e-3]), rng.uniform(3.2e-3 if is_finite else 2e-3, 4e-3)
        pressure = np.sqrt(np.maximum(1 - ((grid - center) ** 2).sum(axis=-1) / radius**2, 0))
        shear = rng.uniform(-0.5, 0.5, 2)
        for load in np.linspace(0.4, 1.0, 4) * rng.uniform(0.5, 1.5 if is_finite else 3.0):
            force = (load / pressure.sum() * pressure)[..., None] * np.array([*shear, -1.0])
            force = force.reshape(-1, 3)
            u = pressed(force)
            places = arms + u if is_finite else arms
            displacement.append(u + rng.normal(0, TOUCH_NOISE_M, force.shape))
            wrench.append(np.concatenate([force.sum(axis=0), np.cross(places, force).sum(axis=0)]))
        displacement.append(np.zeros((slab.n_nodes, 3)))
        wrench.append(np.zeros(6))
    return np.array(displacement), np.array(wrench)


def fitted(board: Board, log: MaterialLog, **how: Prior | bool) -> MaterialFit:
    return kept(fit_material, board, log, NOISE, **how)


def test_finds_the_pad_and_its_uncertainty(board: Board) -> None:
    u, wrench = touches(board, 12, np.random.default_rng(4))
    fit = fitted(board, log_from_frames(u, wrench))
    assert fit.n_touches == 12
    assert (np.abs(fit.values / TRUE - 1) < [0.03, 0.02, 0.03]).all()
    assert (np.abs(fit.values - TRUE) < 3 * fit.interval + [3000, 0.005, 5e-5]).all()
    before, after = (np.sqrt(((w - fit.reference)[:, :3] ** 2).mean()) for w in (fit.before, fit.after))
    assert after < 0.25 * before


def test_deep_presses_are_fitted_at_finite_strain(board: Board) -> None:
    u, wrench = touches(board, 12, np.random.default_rng(4), is_finite=True)
    assert 0.4e-3 < -u[..., 2].min() < 0.6e-3
    log = log_from_frames(u, wrench)
    linear, finite = fitted(board, log), fitted(board, log, is_finite=True)
    assert (np.abs(finite.values / TRUE - 1) < [0.03, 0.02, 0.03]).all()
    assert np.abs(linear.values / TRUE - 1).max() > 0.05
    off = {name: np.sqrt(((f.after - f.reference)[:, :3] ** 2).mean()) for name, f in (("l", linear), ("f", finite))}
    assert off["f"] < 0.6 * off["l"]


def test_a_fit_at_another_strain_is_named(board: Board, tmp_path: Path) -> None:
    u, wrench = touches(board, 12, np.random.default_rng(4), is_finite=True)
    path = tmp_path / "material.json"
    write_fit(path, board, fitted(board, log_from_frames(u, wrench), is_finite=True).report())
    assert json.loads(path.read_text())["strain"] == "finite"
    assert other_strain(path, board, is_finite=True) is None
    said = other_strain(path, board, is_finite=False)
    assert said is not None
    assert said.startswith(f"{path} was fitted at finite strain and is used at linear")
    tree = json.loads(path.read_text())
    del tree["strain"]  # a file of before
    path.write_text(json.dumps(tree))
    assert other_strain(path, board, is_finite=False) is None


def test_a_number_at_the_end_of_what_is_tried_is_named(board: Board) -> None:
    u, wrench = touches(board, 12, np.random.default_rng(4))
    assert fitted(board, log_from_frames(u, wrench)).at_bounds() == []
    u, wrench = touches(board, 12, np.random.default_rng(4), pad=TRUE._replace(thickness_m=4.8e-3))
    (said,) = fitted(board, log_from_frames(u, wrench)).at_bounds()
    assert said.startswith("thickness_m stopped at 0.0044, the highest value that is tried on this board")


def test_the_boards_weights_hold_for_all_its_pads() -> None:
    """The fit of the material has them, so the operator and its sigmas have them, too."""
    board = find_board("gelslim")
    thicker = board_slab(board, Material(2e5, 0.48, 1.15 * board.pad.thickness_um * 1e-6))
    assert fitted_weights(thicker) != fitted_weights(board_slab(board)) == finite_strain_of(board, thicker).weights


def test_a_priors_strain_is_kept_and_another_is_named(board: Board, tmp_path: Path) -> None:
    units = [TRUE._replace(modulus_pa=TRUE.modulus_pa * (1 + 0.01 * i)) for i in range(4)]
    for is_finite in (False, True):
        write_prior(tmp_path / "prior.json", board, fleet_prior(units, is_finite=is_finite))
        assert read_prior(tmp_path / "prior.json", board).is_finite == is_finite
    tree = json.loads((tmp_path / "prior.json").read_text())
    del tree["strain"]  # a file of before
    (tmp_path / "prior.json").write_text(json.dumps(tree))
    assert read_prior(tmp_path / "prior.json", board).is_finite is False
    assert strain_remark("it", fitted=None, used=True) is None
    assert strain_remark("it", fitted=True, used=True) is None
    assert (strain_remark("it", fitted=False, used=True) or "").endswith("fit it again with --strain finite")
    assert (strain_remark("it", fitted=True, used=False) or "").endswith("give --strain finite here, too")
    (tmp_path / "prior.json").write_text(json.dumps({**tree, "strain": "some"}))
    with pytest.raises(InputError, match="strain 'some' is neither linear nor finite"):
        read_prior(tmp_path / "prior.json", board)


def test_the_shape_of_the_displacement_tells_ratio_and_thickness_apart(board: Board) -> None:
    """Five touches, whose wrenches alone leave 1.2 % of nu and 3.2 % of the thickness open."""
    u, wrench = touches(board, 5, np.random.default_rng(10))
    fit = fitted(board, log_from_frames(u, wrench))
    assert (np.abs(fit.values / TRUE - 1) < [0.03, 0.01, 0.015]).all()


def test_a_reference_of_one_axis_is_enough(board: Board) -> None:
    """A kitchen scale under the pad: what it does not measure is NaN."""
    u, wrench = touches(board, 12, np.random.default_rng(4))
    wrench[:, [0, 1, 3, 4, 5]] = np.nan
    fit = fitted(board, log_from_frames(u, wrench))
    assert (np.abs(fit.values / TRUE - 1) < [0.05, 0.02, 0.04]).all()
    report = fit.report()
    assert report["rmse_after_n_nm"][0] is None
    assert report["rmse_after_n_nm"][2] < 0.3 * report["rmse_before_n_nm"][2]
    wrench[3, 2] = np.nan
    with pytest.raises(InputError, match="NaN or infinity"):
        log_from_frames(u, wrench)
    wrench[:, 2] = np.nan
    with pytest.raises(InputError, match="no force along z"):
        log_from_frames(u, wrench)


def test_two_presses_are_enough_where_the_pad_before_is_known(board: Board) -> None:
    """The gel before was 3 % off the new one; without it two presses leave far more open."""
    u, wrench = touches(board, 2, np.random.default_rng(12))
    log = log_from_frames(u, wrench, at_least=1)
    before = Material(TRUE.modulus_pa * 1.03, TRUE.poisson * 0.997, TRUE.thickness_m * 0.99)
    informed = fitted(board, log, prior=next_gel_prior(before))
    alone = fitted(board, log)
    assert (np.abs(informed.values / TRUE - 1) < [0.03, 0.01, 0.02]).all()
    assert (informed.interval < alone.interval).all()
    assert np.abs(informed.values / TRUE - 1).max() < np.abs(np.array(before) / TRUE - 1).max()


def test_a_fleets_prior_has_its_mean_and_spread(board: Board, tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    units = [Material(*(np.array(TRUE) * (1 + rng.normal(0, [0.08, 0.005, 0.02])))) for _ in range(200)]
    prior = fleet_prior(units)
    assert prior.mean == pytest.approx(TRUE, rel=0.02)
    assert np.sqrt(np.diag(prior.covariance)) == pytest.approx([0.08, 0.005, 0.02], rel=0.15)
    path = tmp_path / "prior.json"
    write_prior(path, board, prior)
    again = read_prior(path, board)
    assert isinstance(again, Prior)
    assert again.covariance == pytest.approx(prior.covariance)
    with pytest.raises(InputError, match="3 units tell no spread"):
        fleet_prior(units[:3])
    with pytest.raises(InputError, match="board 'sample', not 'gelslim'"):
        read_prior(path, find_board("gelslim"))
    path.write_text(path.read_text().replace(json.dumps(prior.covariance[0, 0]), "-1.0"))
    with pytest.raises(InputError, match="not positive definite"):
        read_prior(path, board)
    assert not board_prior(board).is_informed


def test_a_log_without_variation_is_refused(board: Board) -> None:
    u, wrench = touches(board, 2, np.random.default_rng(1))
    with pytest.raises(InputError, match="2 touches"):
        log_from_frames(u, wrench)
    with pytest.raises(InputError, match="0 touches"):
        log_from_frames(u, 0 * wrench)


def test_a_log_of_one_load_is_refused(board: Board) -> None:
    """A load cell that stands still while the touches change."""
    u, wrench = touches(board, 6, np.random.default_rng(5))
    touched = np.linalg.norm(wrench[:, :3], axis=1) > 0
    wrench[touched] = [0.1, 0.0, -1.2, 0.0, 0.0, 0.0]
    with pytest.raises(InputError, match=r"reads 1\.2 N within 0\.0 % in every touch"):
        log_from_frames(u, wrench)


def test_a_board_near_incompressibility_can_be_fitted(board: Board) -> None:
    """Three Poisson's ratios to interpolate between, also where the board's own is the highest there is."""
    u, wrench = touches(board, 6, np.random.default_rng(6))
    soft = parse_board(board.text.replace("poisson_1e4 = 4800", "poisson_1e4 = 4999"), "test")
    fit = fitted(soft, log_from_frames(u, wrench))
    assert np.isfinite(fit.values).all()
    assert np.isfinite(fit.after).all()
    stiff = parse_board(board.text.replace("poisson_1e4 = 4800", "poisson_1e4 = 0"), "test")
    with pytest.raises(InputError, match="Poisson's ratio 0 of the board"):
        fitted(stiff, log_from_frames(u, wrench))


def test_a_log_that_contradicts_itself_is_refused(board: Board) -> None:
    rng = np.random.default_rng(2)
    u, wrench = touches(board, 6, rng)
    with pytest.raises(InputError, match="does not fit any pad"):
        fitted(board, log_from_frames(u, wrench * rng.uniform(0.01, 6, (len(wrench), 1))))


def test_nan_and_other_lengths_are_refused(board: Board) -> None:
    u, wrench = touches(board, 1, np.random.default_rng(1))
    with pytest.raises(InputError, match="reference of shape"):
        log_from_frames(u, wrench[:-1])
    u[3, 5, 1] = np.nan
    with pytest.raises(InputError, match="NaN"):
        log_from_frames(u, wrench)


def test_file_round_trip_and_refusals(board: Board, tmp_path: Path) -> None:
    u, wrench = touches(board, 6, np.random.default_rng(8))
    fit = fitted(board, log_from_frames(u, wrench))
    path = tmp_path / "material.json"
    write_fit(path, board, fit.report())
    assert read_material(path, board) == fit.material
    assert read_stiffness_sigma(path, board) == fit.stiffness_sigma
    assert 0 < fit.stiffness_sigma < 0.05
    with pytest.raises(InputError, match="was measured on board 'sample', not 'gelslim'"):
        read_material(path, find_board("gelslim"))
    good = json.loads(path.read_text())
    old = {name: value for name, value in good.items() if name != "stiffness_sigma"}
    path.write_text(json.dumps(old))
    of_modulus = good["interval_95"]["modulus_pa"] / 1.96 / good["modulus_pa"]
    assert read_stiffness_sigma(path, board) == pytest.approx(of_modulus)
    for value in (-0.1, float("nan"), float("inf")):
        path.write_text(json.dumps({**good, "stiffness_sigma": value}))
        with pytest.raises(InputError, match=r"material.json: stiffness_sigma .* is no standard deviation"):
            read_stiffness_sigma(path, board)
    for name, value in (("poisson", 0.5), ("modulus_pa", float("nan")), ("modulus_pa", -1.0), ("modulus_pa", 1e30),
                        ("thickness_m", float("inf")), ("thickness_m", 1e-12)):  # fmt: skip
        path.write_text(json.dumps({**good, name: value}))
        with pytest.raises(InputError, match=f"material.json: {name} .* is no pad of board"):
            read_material(path, board)
    path.write_text(json.dumps({"modulus_pa": "soft"}))
    with pytest.raises(InputError, match="is no file of"):
        read_material(path, board)


def test_reference_csv(tmp_path: Path) -> None:
    path = tmp_path / "w.csv"
    path.write_text("fx,fy,fz,tx,ty,tz\n1,2,3,4,5,6\n0,0,0,0,0,0\n")
    np.testing.assert_allclose(read_wrench_csv(path)[0], [1, 2, 3, 0.004, 0.005, 0.006])
    path.write_text("fx,fy\n1,2\n")
    with pytest.raises(InputError, match="lacks the columns fz, tx, ty, tz"):
        read_wrench_csv(path)
    with pytest.raises(InputError, match="cannot be read"):
        read_wrench_csv(tmp_path / "nothing.csv")
