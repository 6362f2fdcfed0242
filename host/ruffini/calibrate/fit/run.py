"""`ruffini cal fit`: estimator after estimator over a job, then one file that carries its own report."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from ruffini.boards import Board
from ruffini.calibrate import container
from ruffini.calibrate.container import CalibrationFile
from ruffini.calibrate.fit.job import Job, Outcome
from ruffini.calibrate.gates import Gate, gates_in, gates_of_reference, of_stage, verdict
from ruffini.calibrate.log.reference import write_fit
from ruffini.calibrate.log.touches import file_sha256
from ruffini.calibrate.log.warmth import celsius_ranges
from ruffini.errors import InputError, RefusedError, RuffiniError
from ruffini.estimators.table import BY_NAME, applying
from ruffini.rig.log_file import is_log, read_log

Tell = Callable[[str, Outcome, float], None]  # stage, how it ended, seconds
Progress = Callable[[str, float], None]


def run_stages(
    job: Job, skip: frozenset[str], *, tell: Tell, progress: Progress = lambda *_: None
) -> dict[str, Outcome]:
    """Every estimator that the board needs, or `job.only`, whatever the board; what each says, by name.

    Raises
    ------
    InputError
        No such estimator to skip, or one cannot do its work; the text names it.
    """
    unknown = skip - BY_NAME.keys()
    if unknown:
        raise InputError(f"--skip {', '.join(sorted(unknown))}: there is no such stage; there are {', '.join(BY_NAME)}")
    outcomes: dict[str, Outcome] = {}
    for estimator in applying(job.board) if job.only is None else (BY_NAME[job.only],):
        name, start = estimator.name, time.monotonic()
        try:
            if name in skip:
                outcomes[name] = estimator.keep(job)
            elif job.only is not None:
                outcomes[name] = estimator.fit_alone(job, job.options, partial(progress, name))
            else:
                outcomes[name] = estimator.fit(job, partial(progress, name))
        except RuffiniError as error:
            if job.only is None:
                error.add_note(f"in stage {name}; --skip {name} goes on without it")
            raise
        tell(name, outcomes[name], time.monotonic() - start)
    if job.tensors or (job.only is not None and BY_NAME[job.only].makes_numbers):
        return outcomes
    if job.only is not None:
        raise InputError(f"stage {job.only} makes no table by itself: leave --only out")
    raise InputError(f"no stage made anything for board {job.board.name!r}: its pipeline needs no calibration")


def gates_of_stages(board: Board | None, outcomes: dict[str, Outcome]) -> list[Gate]:
    """What each estimator judges of its own report."""
    return [gate for name, o in outcomes.items() for gate in of_stage(name, BY_NAME[name].gates(o.report, board))]


def finished(
    job: Job, outcomes: dict[str, Outcome], serial: str = "*", *, more: Sequence[Gate] = ()
) -> tuple[CalibrationFile, list[Gate]]:
    """The calibration file with stages, gates (`more`: judged elsewhere) and origin in its manifest, and the gates.

    Tables of `job.only` replace those of their kinds in the previous calibration, if there is one; so do its gates.

    Raises
    ------
    RefusedError
        The tables of `job.only` are added to a calibration of another sensor than `serial`.
    """
    metadata = {**job.header(), "sensor_serial": serial}
    base = None if job.only is None or job.previous is None else _without_stage(job.previous, job.only, serial)
    if base is not None:
        metadata |= {key: base.metadata[key] for key in ("sensor_serial", "gel_serial")}
    file = container.pack(job.tensors, metadata)
    found, touches = _said([path for path in job.logs() if is_log(path)])  # HDF5 may be of named columns
    gates = [gate for name in outcomes for gate in of_stage(name, BY_NAME[name].gates_of_log(job, file))]
    gates += [*gates_of_reference(found), *gates_of_stages(job.found, outcomes), *more]
    residuals: dict[str, Any] = {
        "stages": {name: {"state": o.state, "text": o.text, **o.report} for name, o in outcomes.items()},
        "gates": [gate._asdict() for gate in gates], "logs": {path.name: file_sha256(path) for path in job.paths},
        "valid_for": {"temperature_c": celsius_ranges(touches)}, "from_pictures": job.has_new_colours,
    }  # fmt: skip
    if base is not None:
        before = container.residuals(base)
        residuals |= {key: {**before.get(key, {}), **residuals[key]} for key in ("stages", "logs")}
        if not touches:  # nothing says at which temperatures the new tables were fitted
            residuals["valid_for"] = before.get("valid_for", residuals["valid_for"])
    said = {"residuals": _ascii(residuals)} | ({"gates": verdict(gates)} if gates else {})
    file = container.pack(job.tensors, {**metadata, **said})
    if base is None:
        return file, gates
    merged = container.merge([base, file])
    return merged, gates_in(merged) or []


def write_numbers(out: Path, job: Job, outcome: Outcome) -> list[Gate]:
    """Write what `job.only` found as JSON, for the operator; returns its gates."""
    assert job.only is not None
    return write_fit(out, job.board, outcome.report, job.only, BY_NAME[job.only].gates(outcome.report, job.board))


def _without_stage(base: CalibrationFile, stage: str, serial: str) -> CalibrationFile:
    """The previous calibration without tables and gates of a stage that is fitted again, of the sensor `serial`."""
    theirs = base.metadata["sensor_serial"]
    if serial != "*" and theirs not in ("*", serial):
        raise RefusedError(
            f"--unit {serial}: the previous calibration is of sensor {theirs}, and --only {stage} keeps its other "
            "tables: give that sensor's own, or leave --unit out"
        )
    metadata = {**base.metadata, "sensor_serial": theirs if serial == "*" else serial}
    rows = gates_in(base)
    if rows is not None:
        kept = [gate for gate in rows if gate.stage != stage]
        tree = {**container.residuals(base), "gates": [gate._asdict() for gate in kept]}
        metadata |= {"residuals": json.dumps(tree)} | ({"gates": verdict(kept)} if "gates" in metadata else {})
    of_others = {name: text for name, text in metadata.items() if name.split(".")[0] not in BY_NAME[stage].kinds}
    tensors = {name: table for name, table in base.tensors.items() if name.split(".")[0] not in BY_NAME[stage].kinds}
    return container.pack(tensors, of_others)


def _said(logs: list[Path]) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """`found` of each log, and the facts of all their touches."""
    found, touches = [], []
    for path in logs:
        log = read_log(path)
        found.append(dict(log.found))
        touches += [touch.facts for touch in log.touches]
    return found, touches


def _ascii(tree: dict[str, Any]) -> str:
    """JSON of plain ASCII, numbers to six digits: the manifest has little room."""

    def short(value: Any) -> Any:
        if isinstance(value, float):
            return float(f"{value:.6g}")
        if isinstance(value, dict):
            return {k: short(v) for k, v in value.items()}
        return [short(v) for v in value] if isinstance(value, list | tuple) else value

    return json.dumps(short(tree)).encode("ascii", "replace").decode()
