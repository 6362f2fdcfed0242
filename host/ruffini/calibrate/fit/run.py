"""`ruffini cal fit`: stage after stage over a job, then one file that carries its own report."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from ruffini.calibrate import container
from ruffini.calibrate.container import CalibrationFile
from ruffini.calibrate.fit.job import Job, Outcome
from ruffini.calibrate.fit.stages import STAGES
from ruffini.calibrate.gates import Gate, gates_of, gates_of_reference, gates_of_skin, gates_of_stages, judged, verdict
from ruffini.calibrate.log.touches import file_sha256
from ruffini.calibrate.log.warmth import celsius_ranges
from ruffini.errors import InputError, RuffiniError
from ruffini.estimators.skin.judge import judged_presses
from ruffini.rig.log_file import read_log

Tell = Callable[[str, Outcome, float], None]  # stage, how it ended, seconds
Progress = Callable[[str, float], None]


def run_stages(
    job: Job, skip: frozenset[str], *, tell: Tell, progress: Progress = lambda *_: None
) -> dict[str, Outcome]:
    """Every stage that the board needs; what each says, by name.

    Raises
    ------
    InputError
        No such stage to skip, or one cannot do its work; the text names the stage.
    """
    unknown = skip - {stage.name for stage in STAGES}
    if unknown:
        names = ", ".join(stage.name for stage in STAGES)
        raise InputError(f"--skip {', '.join(sorted(unknown))}: there is no such stage; there are {names}")
    outcomes: dict[str, Outcome] = {}
    for stage in STAGES:
        if not stage.is_needed(job):
            continue
        start = time.monotonic()
        try:
            if stage.name in skip:
                outcomes[stage.name] = stage.keep(job)
            else:
                outcomes[stage.name] = stage.run(job, partial(progress, stage.name))
        except RuffiniError as error:
            error.add_note(f"in stage {stage.name}; --skip {stage.name} goes on without it")
            raise
        tell(stage.name, outcomes[stage.name], time.monotonic() - start)
    if not job.tensors:
        raise InputError(f"no stage made anything for board {job.board.name!r}: its pipeline needs no calibration")
    return outcomes


def finished(
    job: Job, outcomes: dict[str, Outcome], serial: str = "*", *, more: Sequence[Gate] = ()
) -> tuple[CalibrationFile, list[Gate]]:
    """The calibration file with stages, gates (`more`: judged elsewhere) and origin in its manifest, and the gates."""
    metadata = {**job.header(), "sensor_serial": serial}
    if "operator" in job.board.pipeline.stages:
        log = job.log()
        previous = judged(job.board, job.previous, log) if job.previous is not None else None
        now = judged(job.board, container.pack(job.tensors, metadata), log)
        gates, touches = gates_of(job.board, log, outcomes, job.fit, now, previous), log.touch_facts
    else:
        logs = [path for path in job.paths if path.suffix == ".h5"]
        found, touches = _said(logs)
        gates = [*gates_of_reference(found), *gates_of_stages(outcomes)]
        if "skin" in job.board.pipeline.stages and logs:
            gates += gates_of_skin(judged_presses(job.board, container.pack(job.tensors, metadata), logs))
    gates += more
    residuals: dict[str, Any] = {
        "stages": {name: {"state": o.state, "text": o.text, **o.report} for name, o in outcomes.items()},
        "gates": [gate._asdict() for gate in gates], "logs": {path.name: file_sha256(path) for path in job.paths},
        "valid_for": {"temperature_c": celsius_ranges(touches)},
    }  # fmt: skip
    said = {"residuals": _ascii(residuals), "gates": verdict(gates)}
    return container.pack(job.tensors, {**metadata, **said}), gates


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
