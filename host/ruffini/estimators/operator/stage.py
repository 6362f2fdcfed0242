"""The inverse finite elements of this unit: solved for its material and its noise, compiled to the board's integers."""

from __future__ import annotations

from ruffini.calibrate.fit.job import Job, Outcome, Progress, Stage
from ruffini.errors import InputError
from ruffini.estimators.material.stage import material_noise
from ruffini.estimators.operator.fit import Material, board_slab, make_operator


def run(job: Job, progress: Progress) -> Outcome:
    """Make the operator, and where the board has one the second pass with its error model."""
    known, sigma = job.material, job.stiffness_sigma
    if job.instant_gain != 1.0:
        slab = board_slab(job.board, known)
        known = Material(slab.modulus_pa * job.instant_gain, slab.poisson, slab.thickness_m)
    method = "support" if "support" in job.board.pipeline.stages else "optimal"
    kind = make_operator(
        job.board, method=method, noise=job.noise or material_noise(job), material=known,
        stiffness_sigma=sigma,
        is_finite=job.is_finite and method == "support", n_touches=job.n_error_touches, progress=progress,
    )  # fmt: skip
    job.tensors |= kind.tensors
    job.metadata |= kind.metadata
    job.matrix = kind.matrix
    text = f"{method}, rounding error {int(kind.metadata['operator.error_1e9']) * 1e-9:.1e}"
    if kind.no_errors is not None:
        text += f"; uncertainty will not be measured: {kind.no_errors}"
    return Outcome("fitted", text, {"method": method, "worst_error_un": kind.metadata["operator.worst_error_un"]})


def keep(job: Job) -> Outcome:
    """The previous calibration's operator, with whatever belongs to it."""
    taken = job.take("operator")
    if taken is None:
        raise InputError("--skip operator needs a calibration that has one: give --previous FILE")
    for kind in ("support", "finite_strain", "gauge", "marker_depth"):
        job.take(kind)
    return taken


def is_needed(job: Job) -> bool:
    """Whether the board solves for forces by finite elements."""
    return "operator" in job.board.pipeline.stages


STAGE = Stage("operator", is_needed, run, keep)
