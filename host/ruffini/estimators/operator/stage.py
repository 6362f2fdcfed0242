"""The inverse finite elements of this unit: solved for its material and its noise, compiled to the board's integers."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from ruffini.boards import Board
from ruffini.calibrate import container
from ruffini.calibrate.container import CalibrationFile
from ruffini.calibrate.fit.job import Job, Outcome, Progress
from ruffini.calibrate.gates import Gate, gates_of_fit_file
from ruffini.calibrate.log.touches import file_sha256, read_touch_log
from ruffini.errors import InputError
from ruffini.estimators.base import Estimator, Report
from ruffini.estimators.material.fit import other_strain, read_material, read_stiffness_sigma
from ruffini.estimators.material.prior import Prior, has_finite_strain, strain_name
from ruffini.estimators.material.stage import MATERIAL, material_noise
from ruffini.estimators.operator.command import COMMAND, OperatorOptions
from ruffini.estimators.operator.fit import Material, OperatorKind, board_slab, make_operator, stiffer
from ruffini.estimators.operator.gauge import gauge_uncertainty_m
from ruffini.estimators.operator.judge import gates_of_forces, gates_of_touches, judged
from ruffini.estimators.operator.page import write_page
from ruffini.estimators.operator.report import report_of
from ruffini.estimators.operator.task import TASK
from ruffini.estimators.relaxation.fit import read_relaxation
from ruffini.estimators.relaxation.stage import RELAXATION
from ruffini.fem.operators import Noise
from ruffini.fem.ridge_weight import RULES, picture, weight_curve


class Operator(Estimator):
    """Forces at the nodes, from displacements."""

    name = COMMAND.name
    command = COMMAND
    kinds = ("operator", "support", "finite_strain", "gauge", "marker_depth")
    is_reported = True
    needed = ("operator",)
    takes_prior = True
    task = TASK

    def applies(self, board: Board) -> bool:
        return "operator" in board.pipeline.stages

    def fit(self, job: Job, progress: Progress) -> Outcome:
        """Make the operator, and where the board has one the second pass with its error model."""
        known, sigma = job.material, job.stiffness_sigma
        if job.instant_gain != 1.0:
            known = stiffer(job.board, known, job.instant_gain)
        method = "support" if "support" in job.board.pipeline.stages else "optimal"
        kind = make_operator(
            job.board, method=method, noise=job.noise or material_noise(job.board), material=known,
            stiffness_sigma=sigma, is_fitted=job.material is not None,
            is_finite=has_finite_strain(job.board, is_asked=job.is_finite), n_touches=job.n_error_touches,
            progress=progress,
        )  # fmt: skip
        _keep(job, kind)
        text = f"{method}, rounding error {int(kind.metadata['operator.error_1e9']) * 1e-9:.1e}"
        if kind.no_errors is not None:
            text += f"; uncertainty will not be measured: {kind.no_errors}"
        return Outcome("fitted", text, {"method": method, "worst_error_un": kind.metadata["operator.worst_error_un"]})

    def fit_alone(self, job: Job, options: OperatorOptions, progress: Progress) -> Outcome:
        """Solve it for the board's own numbers, or those of files of the stages before it."""
        board, method = job.board, options.method
        memory = None if options.relaxation is None else read_relaxation(options.relaxation, board)
        if memory is not None and method != "support":
            raise InputError(f"--relaxation works on the second pass: --method support, not {method}")
        sigma_m = _micrometres(options.noise_um)
        if memory is None and method == "support":
            RELAXATION.keep(job)
        gain = job.instant_gain if memory is None else memory.gain
        remarks: list[str | None] = []
        if options.material is None:
            remarks += MATERIAL.keep(job).remarks
        else:
            job.material = read_material(options.material, board)
            job.stiffness_sigma = read_stiffness_sigma(options.material, board)
            remarks.append(other_strain(options.material, board, is_finite=job.is_finite))
        if job.material is None:
            job.stiffness_sigma = board.pad.stiffness_sigma_1e3 * 1e-3
        gauge_m = _gauge_m(board, job.material, options.gauge_um)
        noise = Noise(sigma_m, gauge_m=gauge_m, tilt_m=options.tilt_um * 1e-6)
        known = job.material if gain == 1.0 else stiffer(board, job.material, gain)
        chosen = _ridge_weight(board, known, noise, options, progress)
        kind = make_operator(
            board, method=method, noise=noise, ridge_weight=chosen.weight, n_touches=job.n_error_touches,
            material=known, stiffness_sigma=job.stiffness_sigma, is_fitted=job.material is not None,
            is_finite=job.is_finite, progress=progress,
        )  # fmt: skip
        _keep(job, kind)
        if memory is not None:
            tensors, metadata = memory.tensors()
            job.tensors |= tensors
            job.metadata |= metadata
        gauge_m = next((table.gauge_m for table in (kind.marker_depth, kind.gauge) if table is not None), gauge_m)
        remarks.append(None if kind.no_errors is None else f"uncertainty will not be measured: {kind.no_errors}")
        report = {"method": method, "strain": strain_name(job.is_finite),
                  **_report(board, kind, gauge_m), **chosen.report}  # fmt: skip
        said = tuple(remark for remark in remarks if remark is not None)
        return Outcome("fitted", _text(report, options.weight), report, remarks=said, files=chosen.files)

    def start(self, job: Job) -> None:
        """The operator of the board's own numbers."""
        _keep(job, make_operator(job.board, method="support", noise=material_noise(job.board)))

    def gates_of_log(self, job: Job, file: CalibrationFile) -> list[Gate]:
        if not job.paths:
            return _gates_of_parts(job.options)
        log, informed = job.log(), job.fit is not None and job.fit.prior.is_informed
        previous = None if job.previous is None else judged(job.board, job.previous, log)
        now = judged(job.board, file, log)
        forces = [] if now is None else gates_of_forces(job.board, log, now, previous)
        return [*gates_of_touches(job.board, log, is_informed=informed), *forces]

    def report(
        self, board: Board, file: CalibrationFile, paths: list[Path], *, previous: CalibrationFile | None = None,
        fleet: Prior | None = None, progress: Progress = lambda _: None,
    ) -> Report:  # fmt: skip
        log = read_touch_log(
            paths, board, file, from_pictures=_saw_pictures(file, paths), progress=lambda done: progress(0.2 * done)
        )
        made = report_of(
            board, file, log, previous=previous, fleet=fleet, progress=lambda done: progress(0.2 + 0.8 * done)
        )
        off_mn = 1e3 * made.tree["wrench"]["force_rmse_n"]
        text = f"force off by {off_mn:.1f} mN RMS over {log.n_touches} touches"
        return Report(made.tree, made.gates, text, lambda path: write_page(path, board, file, made))


def _keep(job: Job, kind: OperatorKind) -> None:
    job.tensors |= kind.tensors
    job.metadata |= kind.metadata
    job.matrix = kind.matrix


def _gates_of_parts(options: OperatorOptions) -> list[Gate]:
    """Those of the measured numbers that it was solved for; the board's own are nobody's measurement."""
    said = [gates_of_fit_file(path) for path in (options.material, options.relaxation) if path is not None]
    return [gate for gates in said for gate in gates or []] if options.material is not None and all(said) else []


def _micrometres(text: str) -> tuple[float, float, float]:
    try:
        values = tuple(float(v) for v in text.split(","))
    except ValueError:
        values = ()
    if len(values) != 3 or not all(0 < v < 1000 for v in values):
        raise InputError(f"--noise-um {text!r}: give three numbers above zero, e.g. 5,5,20")
    return values[0] * 1e-6, values[1] * 1e-6, values[2] * 1e-6


def _gauge_m(board: Board, material: Material | None, gauge_um: float | None) -> float:
    """Uncertainty of the depth's free constant; 0 where a table states it, which is fitted with the operator."""
    is_of_table = board.depth.source == "markers" or board.depth.has_gauge_table
    if is_of_table and gauge_um is not None:
        raise InputError(
            f"--gauge-um: the table that gives {board.name!r} its depth or gauge says itself how far it is off: leave "
            "the option out"
        )
    if is_of_table:
        return 0.0
    return gauge_uncertainty_m(board, material) if gauge_um is None else gauge_um * 1e-6


class _Weight(NamedTuple):
    """A ridge weight, and what is to be said of one that had to be looked for."""

    weight: float
    report: dict[str, float]
    files: tuple[Path, ...] = ()


def _ridge_weight(
    board: Board, material: Material | None, noise: Noise, options: OperatorOptions, progress: Progress
) -> _Weight:
    """The weight that --weight names."""
    weight, plot = options.weight, options.plot
    is_rule = weight in RULES
    if options.method != "ridge":
        if is_rule or plot is not None:
            raise InputError(f"--weight {weight} and --plot are of --method ridge, not of {options.method}")
        return _Weight(0.0, {})
    try:
        value = 0.0 if is_rule else float(weight)
    except ValueError:
        raise InputError(f"--weight {weight!r}: give a number, or one of {', '.join(RULES)}") from None
    if not is_rule and plot is None:
        return _Weight(value, {"weight": value})
    curve = weight_curve(board_slab(board, material), noise, progress=progress)
    value = curve.chosen(weight) if is_rule else value
    said = {"weight": value, "force_error": curve.error_at(value), "force_error_raw": curve.raw_error}
    if plot is None:
        return _Weight(value, said)
    picture(plot, curve, value, f"{board.name}, SIMULATED touches: weight of the ridge operator")
    return _Weight(value, said, (plot,))


def _report(board: Board, kind: OperatorKind, gauge_m: float) -> dict[str, Any]:
    said, depth = kind.metadata, kind.marker_depth
    return {
        "grid": [int(said["operator.n_x"]), int(said["operator.n_y"])],
        "rounding_error": int(said["operator.error_1e9"]) * 1e-9, "gauge_um": gauge_m * 1e6,
        "gauge": "markers" if depth else board.depth.gauge, "form": said["operator.form"],
        "worst_error_un": [int(v) for v in said["operator.worst_error_un"].split(",")],
        "depth_of_markers_um": None if depth is None else [v * 1e6 for v in (depth.sigma_m, depth.pressed_m)],
        "material": said["operator.material"], "no_error_model": kind.no_errors,
        "wrench_error": None if kind.errors is None else kind.errors.wrench.report(),
    }  # fmt: skip


def _text(report: dict[str, Any], weight: str) -> str:
    worst = ",".join(map(str, report["worst_error_un"]))
    text = (
        f"{report['method']} operator, rounding error {report['rounding_error']:.1e}; up to 1 mm a nodal force is off "
        f"by at most {worst} uN (x, y, z); gauge {report['gauge']}, off by {report['gauge_um']:.1f} um"
    )
    if report["depth_of_markers_um"] is not None:
        sigma_um, pressed_um = report["depth_of_markers_um"]
        text += f"; depth from the markers is off by {sigma_um:.0f} um of {pressed_um:.0f} um where something presses"
    if "weight" in report:
        text += f"; ridge weight {report['weight']:.2g}"
    if "force_error" in report:
        text += (
            f" by {weight}: force error {100 * report['force_error']:.0f} % on simulated touches, "
            f"{100 * report['force_error_raw']:.0f} % without ridge"
        )
    return text


def _saw_pictures(file: CalibrationFile, paths: list[Path]) -> bool:
    """True if the fit saw these logs with colours that it had learned itself, not with those of the sensor then."""
    said = container.residuals(file)
    fitted = said.get("logs")
    if said.get("from_pictures") is not True or not isinstance(fitted, dict):
        return False
    return all(file_sha256(path) in fitted.values() for path in paths)


OPERATOR = Operator()
