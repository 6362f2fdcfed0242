"""Softness of made squeezes, whose dent follows Hertz: the gel's share of the curvature of a rigid object's."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from ruffini.boards import find_board
from ruffini.errors import InputError
from ruffini.estimators.softness.model import (
    Grid,
    Share,
    Softness,
    chance_of_wrong,
    dent_of,
    fit_softness,
    gel_pa_of,
    grid_of,
    mean_of,
    rise_of,
)
from ruffini.estimators.wrench.log import FeatureRun

GRID, GEL_PA, SLOPE = Grid(10, 8), 200e3, 0.3
MODULI = {"steel": np.inf, "soft": 50e3, "hard": 300e3, "foam": 10e3}
SCATTER = 0.1  # octaves


def squeeze(name: str, k: int, rng: np.random.Generator, modulus_pa: float) -> FeatureRun:
    """A bowl whose curvature is the share E / (E + G) of a rigid one's; force to 5 N and back."""
    force = 5 * np.sin(np.linspace(0, np.pi, 60)) ** 2
    share = 1.0 if np.isinf(modulus_pa) else modulus_pa / (modulus_pa + GEL_PA)
    size = share * 2.0 ** rng.normal(0, SCATTER) * 500 * np.maximum(force, 0) ** SLOPE
    y, x = np.mgrid[: GRID.n_y, : GRID.n_x]
    bowl = np.stack([0 * x, (x - 4.5), (y - 3.5)]).reshape(-1)
    features = size[:, None] * bowl + rng.normal(0, 1, (len(force), bowl.size))
    wrench = np.zeros((len(force), 6))
    wrench[:, 2] = -force
    time_s = np.arange(len(force)) / 30
    return FeatureRun(f"{name}_{k}", time_s, features, np.ones(len(force), bool), time_s, wrench, recording=name)


@pytest.fixture(scope="module")
def runs() -> list[FeatureRun]:
    rng = np.random.default_rng(1)
    return [squeeze(name, k, rng, pa) for name, pa in MODULI.items() for k in range(4)]


@pytest.fixture(scope="module")
def fit(runs: list[FeatureRun]) -> Softness:
    return fit_softness([r for r in runs if r.recording != "soft"], GRID, ["steel"], (0.7, 3.0), GEL_PA)


def shares(fit: Softness, runs: list[FeatureRun], name: str) -> list[Share]:
    found = [fit.share(dent_of(r.features, GRID), -r.reference[:, 2]) for r in runs if r.recording == name]
    return [share for share in found if share is not None]


def test_an_object_that_was_not_fitted_has_its_modulus_in_the_interval(fit: Softness, runs: list[FeatureRun]) -> None:
    assert fit.slope == pytest.approx(SLOPE, abs=0.02)
    assert fit.sigma == pytest.approx(SCATTER, rel=0.6)
    found = mean_of(shares(fit, runs, "soft"))
    assert found.sigma == pytest.approx(fit.sigma / 2)
    assert fit.modulus_pa(found.log) == pytest.approx(MODULI["soft"], rel=0.15)
    low, high = fit.interval_pa(Share(found.log, 2 * found.sigma))
    assert low < MODULI["soft"] < high
    assert fit.modulus_pa(mean_of(shares(fit, runs, "steel")).log) == np.inf


def test_known_moduli_give_the_scale(runs: list[FeatureRun]) -> None:
    other = [r for r in runs if r.recording != "soft"]
    fit = fit_softness(other, GRID, ["steel"], (0.7, 3.0), 1.0, {"foam": 2 * MODULI["foam"]})
    assert fit.gel_pa == pytest.approx(2 * GEL_PA, rel=0.15)


def test_the_chance_of_being_wrong() -> None:
    assert chance_of_wrong(Share(-2.0, 0.3), Share(-1.5, 0.4)) == pytest.approx(0.158655, abs=1e-5)  # one sigma
    assert chance_of_wrong(Share(-1.5, 0.3), Share(-2.0, 0.4)) == pytest.approx(0.158655, abs=1e-5)
    assert chance_of_wrong(Share(-2.0, 0.3), Share(-2.0, 0.3)) == 0.5


def test_an_uncertain_force_widens_the_interval(fit: Softness) -> None:
    force = np.array([0.0, 1.0, 2.0, 4.0])
    dent = np.full(4, 10.0)
    exact, unsure = fit.share(dent, force), fit.share(dent, force, 0.3 * force)
    assert exact is not None
    assert unsure is not None
    assert exact.sigma == fit.sigma
    assert unsure.sigma == pytest.approx(np.hypot(fit.sigma, fit.slope * 0.3 / np.log(2)))


@pytest.mark.parametrize(
    ("force", "frames"),
    [
        ([0.0, 0.8, 1.5, 3.2, 4.0], [1, 2, 3]),
        ([0.0, 0.8, 0.5, 0.8, 3.0], [1, 2, 3, 4]),  # half of 0.7 N is not reached
        ([0.0, 0.8, 0.3, 1.0, 3.0], [3, 4]),
        ([0.0, 0.8, 2.9, 0.1], None),
        ([0.0, 5.0, 1.0, 4.0], None),
        ([0.0, 5.0, 0.0, 1.0, 4.0], [3, 4]),
    ],
)
def test_the_frames_of_a_rise(force: list[float], frames: list[int] | None) -> None:
    found = rise_of(np.array(force), 0.7, 3.0)
    assert (None if found is None else found.tolist()) == frames


def test_what_cannot_be_fitted_is_refused(runs: list[FeatureRun]) -> None:
    with pytest.raises(InputError, match=r"no recording of a rigid object \(iron\) rises from 0\.7 to 3 N"):
        fit_softness(runs, GRID, ["iron"], (0.7, 3.0), GEL_PA)
    with pytest.raises(InputError, match="no recording of a rigid object"):
        fit_softness(runs, GRID, ["steel"], (0.7, 6.0), GEL_PA)
    with pytest.raises(InputError, match="no object was squeezed twice"):
        fit_softness([r for r in runs if r.name.endswith("_0")], GRID, ["steel"], (0.7, 3.0), GEL_PA)
    with pytest.raises(InputError, match=r"the gel's scale would be .*e\+\d+ Pa, beyond 1 to 1e\+09"):
        fit_softness(runs, GRID, ["steel"], (0.7, 3.0), GEL_PA, {"foam": 1e11})
    with pytest.raises(InputError, match="squeeze_n of 1e-09 and 3 N: they must rise from 1e-6 N"):
        fit_softness(runs, GRID, ["steel"], (1e-9, 3.0), GEL_PA)


def test_boards_with_too_few_cells_are_refused() -> None:
    assert grid_of(find_board("gelsight-wedge")) == GRID
    assert gel_pa_of(find_board("gelsight-wedge")) == pytest.approx(150e3 / (1 - 0.48**2))
    with pytest.raises(InputError, match=r"'gelslim' has no \[picture_features\]"):
        grid_of(find_board("gelslim"))


def test_the_rim_does_not_count() -> None:
    features: npt.NDArray[np.float64] = np.zeros((1, 3, 8, 10))
    features[..., :2, :] = features[..., -2:, :] = features[..., :2] = features[..., -2:] = 1e4
    assert dent_of(features.reshape(1, -1), GRID)[0] == 0.0
