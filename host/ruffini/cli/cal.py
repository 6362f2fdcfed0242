"""Verbs of calibration: make tables, flash them, check them."""

from __future__ import annotations

import resource
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ruffini.cli.common import BoardOption, JsonFlag, emit, emit_judged, note, note_start, progress_bar
from ruffini.cli.device import open_sensor
from ruffini.errors import InputError

if TYPE_CHECKING:
    from ruffini.boards import Board
    from ruffini.estimators.operator.fit import Material
    from ruffini.fem.operators import Noise


OutOption = Annotated[Path, typer.Option("--out", help="Calibration file to write.")]
FILE = typer.Argument(help="Calibration file.")


def _micrometres(text: str) -> tuple[float, float, float]:
    try:
        values = tuple(float(v) for v in text.split(","))
    except ValueError:
        values = ()
    if len(values) != 3 or not all(0 < v < 1000 for v in values):
        raise InputError(f"--noise-um {text!r}: give three numbers above zero, e.g. 5,5,20")
    return values[0], values[1], values[2]


def operator(
    board: BoardOption,
    out: OutOption,
    method: Annotated[
        str, typer.Option(help="raw, ridge, optimal, or support (optimal with the second pass).")
    ] = "support",
    noise_um: Annotated[str, typer.Option(help="Noise of the displacement along x,y,z, micrometres.")] = "5,5,20",
    gauge_um: Annotated[
        float | None,
        typer.Option(
            help="Uncertainty of the depth's free constant (optimal, support). Without: what the board's [depth] gauge "
            "is off by under simulated touches. Not for gauges by a table nor for depth from markers: they say it."
        ),
    ] = None,
    tilt_um: Annotated[
        float, typer.Option(help="Uncertainty of the depth's tilt at the edge (optimal, support).")
    ] = 30.0,
    weight: Annotated[
        str, typer.Option(help="ridge: w over the largest eigenvalue squared, or lcurve or cv to choose it.")
    ] = "1e-4",
    plot: Annotated[Path | None, typer.Option(help="ridge: picture (PNG) of the curves behind the weight.")] = None,
    material: Annotated[
        Path | None, typer.Option(help="File of `cal fit --only material`: E, Poisson's ratio, thickness as measured.")
    ] = None,
    relaxation: Annotated[
        Path | None,
        typer.Option(help="File of `cal fit --only relaxation`: what the pad loses under a held strain (support)."),
    ] = None,
    strain: Annotated[
        str,
        typer.Option(
            help="finite for a real pad (support): adds what finite strain makes, to second order; or linear."
        ),
    ] = "linear",
    touches: Annotated[
        int,
        typer.Option(min=0, help="Simulated touches that the error model is fitted on (support); 0: none is stated."),
    ] = 120,
    json_: JsonFlag = False,
) -> None:
    """Solve the inverse FEM of a board and compile it to the board's integers."""
    note_start("cal fit --only operator", board)
    from ruffini.boards import find_board
    from ruffini.calibrate import container
    from ruffini.calibrate.gates import gates_of_fit_file, manifest_of
    from ruffini.estimators.material.fit import read_material, read_stiffness_sigma
    from ruffini.estimators.operator.fit import make_operator, stiffer
    from ruffini.estimators.operator.gauge import gauge_uncertainty_m
    from ruffini.estimators.relaxation.fit import read_relaxation
    from ruffini.fem.operators import Noise

    start = time.perf_counter()
    if strain not in ("linear", "finite"):
        raise InputError(f"--strain {strain!r}: choose linear or finite")
    found = find_board(board)
    x, y, z = _micrometres(noise_um)
    known = None if material is None else read_material(material, found)
    memory = None if relaxation is None else read_relaxation(relaxation, found)
    sigma = found.pad.stiffness_sigma_1e3 * 1e-3 if material is None else read_stiffness_sigma(material, found)
    is_judged = found.depth.source == "markers" or found.depth.has_gauge_table  # when the table is fitted
    if is_judged and gauge_um is not None:
        raise InputError(
            f"--gauge-um: the table that gives {found.name!r} its depth or gauge says itself how far it is off: leave "
            "the option out"
        )
    gauge_m = 0.0 if is_judged else gauge_uncertainty_m(found, known) if gauge_um is None else gauge_um * 1e-6
    noise = Noise((x * 1e-6, y * 1e-6, z * 1e-6), gauge_m=gauge_m, tilt_m=tilt_um * 1e-6)
    if memory is not None and method != "support":
        raise InputError(f"--relaxation works on the second pass: --method support, not {method}")
    if memory is not None:
        known = stiffer(found, known, memory.gain)
    chosen, said = _ridge_weight(found, known, noise, method, weight, plot)
    with progress_bar("inverse FEM") as progress:
        kind = make_operator(
            found, method=method, noise=noise, ridge_weight=chosen, n_touches=touches, material=known,
            stiffness_sigma=sigma, is_finite=strain == "finite", progress=progress,
        )  # fmt: skip
    tensors, metadata = ({}, {}) if memory is None else memory.tensors()
    # The board's own numbers are nobody's measurement: only a fitted pad has gates.
    fitted = [path for path in (material, relaxation) if path is not None]
    said_of = [gates_of_fit_file(path) for path in fitted]
    if material is not None and all(said_of):
        metadata = {**metadata, **manifest_of({}, [gate for gates in said_of for gate in gates or []])}
    file = container.pack({**kind.tensors, **tensors}, {**container.base_metadata(found), **kind.metadata, **metadata})
    container.write(out, file)
    error = int(kind.metadata["operator.error_1e9"]) * 1e-9
    seconds = time.perf_counter() - start
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024  # Linux counts in 1024 bytes
    depth = kind.marker_depth
    gauge_m = next((table.gauge_m for table in (depth, kind.gauge) if table is not None), gauge_m)
    result = {"file": str(out), "board": found.name, "method": method, "strain": strain,
              "grid": [int(kind.metadata["operator.n_x"]), int(kind.metadata["operator.n_y"])],
              "rounding_error": error, "bytes": len(file.data), "gauge_um": gauge_m * 1e6,
              "gauge": "markers" if depth else found.depth.gauge,
              "form": kind.metadata["operator.form"], "seconds": seconds, "peak_mb": peak_mb,
              "worst_error_un": [int(v) for v in kind.metadata["operator.worst_error_un"].split(",")],
              "depth_of_markers_um": None if depth is None else [v * 1e6 for v in (depth.sigma_m, depth.pressed_m)],
              "material": kind.metadata["operator.material"], **said,
              "wrench_error": None if kind.errors is None else kind.errors.wrench.report(),
              "no_error_model": kind.no_errors}  # fmt: skip
    if kind.no_errors is not None:
        note(f"{out}: uncertainty will not be measured: {kind.no_errors}")
    emit(
        result,
        json_,
        f"{out}: {method} operator of {found.name}, {len(file.data) / 1e6:.1f} MB, rounding error {error:.1e}; "
        f"up to 1 mm a nodal force is off by at most {kind.metadata['operator.worst_error_un']} uN (x, y, z)"
        f"; {seconds:.1f} s, {peak_mb:.0f} MB of memory at most; gauge {result['gauge']}, off by {gauge_m * 1e6:.1f} um"
        + (
            f"; depth from the markers is off by {depth.sigma_m * 1e6:.0f} um of {depth.pressed_m * 1e6:.0f} um "
            "where something presses"
            if depth
            else ""
        )
        + (f"; ridge weight {chosen:.2g}" if method == "ridge" else "")
        + (
            f" by {weight}: force error {100 * said['force_error']:.0f} % on simulated touches, "
            f"{100 * said['force_error_raw']:.0f} % without ridge"
            if said
            else ""
        ),
    )


def _ridge_weight(
    board: Board, material: Material | None, noise: Noise, method: str, weight: str, plot: Path | None
) -> tuple[float, dict[str, float]]:
    """The weight that --weight names, and what is to be said of it where it had to be looked for."""
    from ruffini.estimators.operator.fit import board_slab
    from ruffini.fem.ridge_weight import RULES, picture, weight_curve

    is_rule = weight in RULES
    if method != "ridge":
        if is_rule or plot is not None:
            raise InputError(f"--weight {weight} and --plot are of --method ridge, not of {method}")
        return 0.0, {}
    try:
        value = 0.0 if is_rule else float(weight)
    except ValueError:
        raise InputError(f"--weight {weight!r}: give a number, or one of {', '.join(RULES)}") from None
    if not is_rule and plot is None:
        return value, {}
    with progress_bar("ridge weight") as progress:
        curve = weight_curve(board_slab(board, material), noise, progress=progress)
    value = curve.chosen(weight) if is_rule else value
    if plot is not None:
        picture(plot, curve, value, f"{board.name}, SIMULATED touches: weight of the ridge operator")
    return value, {"weight": value, "force_error": curve.error_at(value), "force_error_raw": curve.raw_error}


def material(
    log: Annotated[Path, typer.Option("--log", help="Recording of touches: video, or folder of frames.")],
    calibration: Annotated[Path, typer.Option("--calibration", help="File with operator, support and colours.")],
    out: Annotated[Path, typer.Option("--out", help="JSON to write, for `cal fit --only operator --material`.")],
    reference: Annotated[
        Path | None,
        typer.Option(
            help="CSV, a row a frame: fx,fy,fz in N, tx,ty,tz in N mm (default: wrench.csv of the recording)."
        ),
    ] = None,
    board: Annotated[str | None, typer.Option(help="Default: the board that the calibration names.")] = None,
    plot: Annotated[Path | None, typer.Option(help="Picture (PNG) of the residuals before and after.")] = None,
    json_: JsonFlag = False,
) -> None:
    """Fit E, Poisson's ratio and thickness to a recording with a reference wrench; 95 % intervals."""
    note_start("cal fit --only material", board)
    from ruffini.calibrate import container
    from ruffini.calibrate.log.reference import write_fit
    from ruffini.estimators.material.fit import fit_material, log_from_recording
    from ruffini.estimators.material.judge import gates_of_material
    from ruffini.estimators.material.stage import MATERIAL, material_noise

    file = container.read(calibration)
    found = container.board_of(file, board)
    with progress_bar("frames") as progress:
        frames = log_from_recording(found, file, log, reference, progress=progress)
    with progress_bar("fit") as progress:
        fit = fit_material(found, frames, material_noise(found), progress=progress)
    report = fit.report()
    gates = write_fit(out, found, report, MATERIAL.name, gates_of_material(fit, found))
    before, after = (
        1e3 * sum((v or 0.0) ** 2 for v in report[k][:3]) ** 0.5 for k in ("rmse_before_n_nm", "rmse_after_n_nm")
    )
    text = f"{out}: {fit.text()}; force RMSE {before:.1f} -> {after:.1f} mN"
    if plot is not None:
        from ruffini.estimators.material.picture import residuals

        residuals(plot, fit, title=f"{found.name}: material from {log.name}")
        text += f"\n{plot}"
    emit_judged({"file": str(out), **report}, gates, json_, text)


def fit_relaxation_of_log(
    log: Annotated[Path, typer.Option("--log", help="Recording of touches held for seconds: video, or frames.")],
    calibration: Annotated[Path, typer.Option("--calibration", help="File with operator, support and colours.")],
    out: Annotated[Path, typer.Option("--out", help="JSON to write, for `cal fit --only operator --relaxation`.")],
    reference: Annotated[
        Path | None, typer.Option(help="CSV, a row a frame, as of `cal fit --only material` (default: wrench.csv).")
    ] = None,
    board: Annotated[str | None, typer.Option(help="Default: the board that the calibration names.")] = None,
    json_: JsonFlag = False,
) -> None:
    """Fit how much force the pad loses under a held strain, and how fast, to a recording with a reference wrench."""
    note_start("cal fit --only relaxation", board)
    from ruffini.calibrate import container
    from ruffini.calibrate.log.reference import write_fit
    from ruffini.estimators.relaxation.fit import fit_relaxation, log_from_recording
    from ruffini.estimators.relaxation.stage import RELAXATION

    file = container.read(calibration)
    found = container.board_of(file, board)
    with progress_bar("frames") as progress:
        frames = log_from_recording(found, file, log, reference, progress=progress)
    fit = fit_relaxation(frames)
    report = fit.report()
    gates = write_fit(out, found, report, RELAXATION.name, RELAXATION.gates(report, found))
    emit_judged(report, gates, json_,
         f"{out}: {fit.text()}; at once it is {fit.gain:.3f} times the calibration's; "
         f"force RMSE {1e3 * fit.rmse_before_n:.1f} -> {1e3 * fit.rmse_after_n:.1f} mN")  # fmt: skip


def photometric(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Ball presses: reference.png, images.")],
    board: BoardOption,
    out: OutOption,
    ball_mm: Annotated[float | None, typer.Option(help="Diameter of the ball (default: presses.toml).")] = None,
    px_per_mm: Annotated[float | None, typer.Option(help="Scale of the images (default: presses.toml).")] = None,
    truth: Annotated[
        Path | None, typer.Option(help="CSV of contact circles (default: DIR/presses.csv; without one they are found).")
    ] = None,
    camera: Annotated[
        Path | None,
        typer.Option(help="File of `cal fit --only camera`: where each pixel looks, in place of board.toml's pinhole."),
    ] = None,
    dark: Annotated[
        Path | None,
        typer.Option(
            help="File of `cal fit --only dark`, where the sensor will have it too: give both to `cal flash`."
        ),
    ] = None,
    foreign: Annotated[
        bool,
        typer.Option("--foreign", help="The presses come from other optics than the board's: z stays UNCALIBRATED."),
    ] = False,
    source: Annotated[
        str,
        typer.Option(help="colour (side light: colours -> slopes), intensity (a skin that darkens -> depth), or auto."),
    ] = "auto",
    report: Annotated[
        Path | None,
        typer.Option(help="HTML page, and JSON beside it, with every press judged by a table fitted without it."),
    ] = None,
    json_: JsonFlag = False,
) -> None:
    """Fit colour change -> surface slope, or brightness -> depth, on ball presses of known size."""
    note_start("cal fit --only photometric", board)
    from ruffini.boards import find_board
    from ruffini.calibrate import container, keys
    from ruffini.calibrate.fit.job import Job
    from ruffini.calibrate.gates import write_judged
    from ruffini.estimators.camera.stage import CAMERA
    from ruffini.estimators.dark.frame import dark_of
    from ruffini.estimators.dark.stage import DARK
    from ruffini.estimators.photometric.fitted import fit_presses
    from ruffini.estimators.photometric.pad_view import pad_view
    from ruffini.estimators.photometric.presses import load_presses
    from ruffini.estimators.photometric.stage import PHOTOMETRIC

    found = find_board(board)
    job = Job(found, [])
    for estimator, path in ((CAMERA, camera), (DARK, dark)):
        job.parts = []
        if path is not None:
            job.parts = [keys.read_verified(path)]
            container.check_board(job.parts[0], found)
            estimator.need(job.parts[0], path)
        estimator.keep(job)
    presses = load_presses(folder, ball_mm=ball_mm, px_per_mm=px_per_mm, truth=truth, may_find=True, at_least=1)
    presses, view = presses.less(dark_of(job.tensors)), pad_view(found, job.tensors, job.metadata)
    with progress_bar("fit") as progress:
        fit = fit_presses(presses, found, is_foreign=foreign, source=source, view=view, progress=progress)
        said = PHOTOMETRIC.gates(fit.report, found)
        gates = write_judged(out, PHOTOMETRIC.name, said, found, fit.tensors, fit.report, fit.metadata)
        result, text = {"file": str(out), **fit.report}, f"{out}: {fit.summary}"
        if report is not None:
            from ruffini.evaluate.press_report import write_report

            result["report"] = [str(path) for path in write_report(report, presses, fit, found, progress)]
            text += "\n" + "\n".join(result["report"])
    emit_judged(result, gates, json_, text)


def merge(
    files: Annotated[list[Path], typer.Argument(help="Calibration files; later ones win.")],
    out: OutOption,
    json_: JsonFlag = False,
) -> None:
    """One file with the kinds of several."""
    from ruffini.calibrate import container, keys

    merged = container.merge([keys.read_verified(f) for f in files])
    container.write(out, merged)
    emit({"file": str(out), "kinds": merged.kinds}, json_, f"{out}: {', '.join(merged.kinds)}")


def verify(
    file: Annotated[Path, FILE],
    board: Annotated[str | None, typer.Option(help="Also: is it for this board, and does the core take it?")] = None,
    json_: JsonFlag = False,
) -> None:
    """Check a file's layout and signature, and that the core can prove it."""
    from ruffini.calibrate import container, keys
    from ruffini.core import Pipeline

    read = container.read(file)
    signer = keys.verify(read)
    if board is not None:
        Pipeline(container.board_of(read, board), read.data).close()
    emit({"file": str(file), "ok": True, "kinds": read.kinds, "board": read.metadata["board"],
          "signer": signer}, json_,
         f"{file}: {', '.join(read.kinds)} for {read.metadata['board']}, signed by {signer}")  # fmt: skip


def show(file: Annotated[Path, FILE], json_: JsonFlag = False) -> None:
    """Print what a calibration file says of itself."""
    from ruffini.calibrate import container

    read = container.read(file)
    tensors = {k: f"{v.dtype} {list(v.shape)}" for k, v in read.tensors.items()}
    text = "\n".join(
        [*(f"{k} = {v}" for k, v in read.metadata.items()), "", *(f"{k}: {v}" for k, v in tensors.items())]
    )
    emit({"metadata": read.metadata, "tensors": tensors, "sha256": read.sha256.hex()}, json_, text)


def zero(
    n: Annotated[int, typer.Option("--n", min=0, help="Frames to average (0 = the board's own number).")] = 0,
    touched: Annotated[
        bool, typer.Option("--even-if-touched", help="Make what presses on the pad now part of rest.")
    ] = False,
    wait: Annotated[bool, typer.Option("--wait/--no-wait", help="Wait until it is learned.")] = True,
    json_: JsonFlag = False,
) -> None:
    """Learn the untouched image again. Nothing may touch the pad: else the device keeps the old image."""
    from ruffini.device.zeroing import learn_rest

    with open_sensor() as sensor:
        learn_rest(sensor, n, even_if_touched=touched, waits=wait)
    emit({"ok": True}, json_, f"{sensor.port}: {'rest is learned' if wait else 'learning rest'}")
