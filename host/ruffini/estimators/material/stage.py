"""E, Poisson's ratio and thickness from wrench and displacement of held touches."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ruffini.calibrate.fit.job import Job, Outcome, Progress, Stage, material_of, stiffness_sigma_of
from ruffini.estimators.material.fit import MIN_TOUCHES, MaterialFit, fit_material, log_of_touches
from ruffini.estimators.operator.gauge import gauge_uncertainty_m
from ruffini.fem.operators import Noise

Array = npt.NDArray[np.float64]

SIGMA_M, TILT_M = (5e-6, 5e-6, 20e-6), 30e-6  # of the displacement under a touch: as `cal fit --only operator` has them


def material_noise(job: Job) -> Noise:
    """What the displacement is weighted with while the material is sought."""
    return Noise(SIGMA_M, gauge_m=gauge_uncertainty_m(job.board), tilt_m=TILT_M)


def run(job: Job, progress: Progress) -> Outcome:
    """Fit; with a fleet's or a previous calibration's numbers a few presses are enough."""
    log, prior = job.log(lambda done: progress(0.3 * done)), job.prior()
    touches = log_of_touches(log.displacement, log.wrench, log.touch, 1 if prior.is_informed else MIN_TOUCHES)
    fit = fit_material(
        job.board, touches, material_noise(job), prior=prior, progress=lambda done: progress(0.3 + 0.7 * done)
    )
    job.fit, job.material, job.stiffness_sigma = fit, fit.material, fit.stiffness_sigma
    e, nu, h = fit.values
    e_i, nu_i, h_i = fit.interval
    report = {**fit.report(), "left_out": left_out_figures(fit)}
    return Outcome(
        "fitted",
        f"E {e / 1e3:.1f} +- {e_i / 1e3:.1f} kPa, Poisson's ratio {nu:.4f} +- {nu_i:.4f}, thickness {1e3 * h:.3f} +- "
        f"{1e3 * h_i:.3f} mm (95 %, {fit.n_touches} touches, prior: {prior.source}); force of a touch left out: "
        f"{1e3 * report['left_out']['force_rmse_n']:.1f} mN RMS",
        report,
    )


def left_out_figures(fit: MaterialFit) -> dict[str, float]:
    """Error of the force of each touch by a fit to the others."""
    return touch_figures(fit, fit.left_out)


def touch_figures(fit: MaterialFit, wrench: Array) -> dict[str, float]:
    """Error of a fit's wrenches (t, 6), force, N: over touches, each the mean of its frames."""
    seen = np.isfinite(fit.reference[:, :3]).all(axis=0)
    touches = [fit.touch == t for t in np.unique(fit.touch)]
    error = np.array([(wrench - fit.reference)[used][:, :3][:, seen].mean(axis=0) for used in touches])
    size = np.array([fit.reference[used][:, :3][:, seen].mean(axis=0) for used in touches])
    length, largest = np.linalg.norm(error, axis=1), float(np.linalg.norm(size, axis=1).max())
    return {
        "force_rmse_n": float(np.sqrt(np.mean(length**2))), "force_p95_n": float(np.percentile(length, 95)),
        "largest_force_n": largest,
        "gain": float((size * (size + error)).sum() / (size**2).sum()),
    }  # fmt: skip


def keep(job: Job) -> Outcome:
    """The previous calibration's numbers, or the board's."""
    job.material = material_of(job.previous)
    if job.material is None:
        return Outcome("board", "board.toml's numbers")
    job.stiffness_sigma = stiffness_sigma_of(job.previous)
    return Outcome("kept", "the previous numbers")


def is_needed(job: Job) -> bool:
    """Whether the board solves for forces by finite elements."""
    return "operator" in job.board.pipeline.stages


STAGE = Stage("material", is_needed, run, keep)
