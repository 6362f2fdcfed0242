"""ruffini cal fit: a calibration from a log of touches."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ruffini.cli.common import BoardOption, JsonFlag, emit, note, progress_bar

if TYPE_CHECKING:
    from ruffini.calibrate.fit.job import Outcome


def fit(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help="Logs of `cal collect`, or recordings.")],
    board: BoardOption,
    out: Annotated[Path, typer.Option("--out", help="Calibration file to write.")],
    previous: Annotated[
        Path | None, typer.Option(help="Calibration before: what is not fitted is kept, and few presses are enough.")
    ] = None,
    fleet: Annotated[Path | None, typer.Option("--prior", help="File of `cal fleet`: what units are like.")] = None,
    balls: Annotated[Path | None, typer.Option(help="Ball presses, as of `cal fit --only photometric`.")] = None,
    given: Annotated[
        list[Path] | None,
        typer.Option("--with", help="File of `cal fit --only camera` or `cal fit --only photometric` to build on."),
    ] = None,
    points: Annotated[
        Path | None, typer.Option(help="Known points of a tube's lens, as of `cal fit --only skin`.")
    ] = None,
    skip: Annotated[list[str] | None, typer.Option(help="Stage to leave out; may be given again.")] = None,
    only: Annotated[
        str | None, typer.Option(help="One stage alone; with --help the options of a stage that has its own.")
    ] = None,
    strain: Annotated[str, typer.Option(help="finite for a real pad, or linear.")] = "linear",
    touches: Annotated[int, typer.Option(min=0, help="Simulated touches behind the stated uncertainty.")] = 120,
    serial: Annotated[str, typer.Option("--unit", help="Serial number of the sensor that it is for.")] = "*",
    json_: JsonFlag = False,
) -> None:
    """Fit what the board needs, stage after stage, to a log; the file carries its gates."""
    note(f"cal fit: board {board}")
    from ruffini.boards import find_board
    from ruffini.calibrate import container, keys
    from ruffini.calibrate.fit.job import Job
    from ruffini.calibrate.fit.run import finished, run_stages
    from ruffini.calibrate.gates import failed
    from ruffini.errors import InputError
    from ruffini.estimators.material.prior import read_prior
    from ruffini.estimators.table import BY_NAME

    if strain not in ("linear", "finite"):
        raise InputError(f"--strain {strain!r}: choose linear or finite")
    found = find_board(board)
    job = Job(
        found, logs, None if previous is None else keys.read_verified(previous),
        [keys.read_verified(path) for path in given or []], balls, None if fleet is None else read_prior(fleet, found),
        is_finite=strain == "finite", n_error_touches=touches, points=points,
    )  # fmt: skip
    for file in [*job.parts, *([job.previous] if job.previous else [])]:
        container.check_board(file, found)
    left_out = frozenset(skip or [])
    if only is not None:
        if only not in BY_NAME:
            raise InputError(f"--only {only!r}: there is no such stage; there are {', '.join(BY_NAME)}")
        left_out |= BY_NAME.keys() - {only}
    start = time.monotonic()
    with progress_bar("fit") as bar:
        outcomes = run_stages(job, left_out, tell=teller(), progress=lambda _, done: bar(done))
        file, gates = finished(job, outcomes, serial)
    container.write(out, file)
    bad = failed(gates)
    for gate in gates:
        note(f"{'ok  ' if gate.ok else 'open' if gate.ok is None else 'FAIL'} {gate.name}: {gate.text}")
    emit(
        {"file": str(out), "board": found.name, "kinds": file.kinds,
         "seconds": time.monotonic() - start, "passed": not bad,
         "stages": {name: {"state": o.state, "text": o.text, **o.report} for name, o in outcomes.items()},
         "gates": [gate._asdict() for gate in gates]},
        json_,
        f"{out}: {', '.join(file.kinds)} from {', '.join(path.name for path in logs)}; "
        + (f"FAILS {', '.join(g.name for g in bad)}: it will not be flashed" if bad else "passes its gates"),
    )  # fmt: skip
    if bad:
        raise typer.Exit(1)


def teller() -> Callable[[str, Outcome, float], None]:
    """Says each stage as it ends."""

    def tell(name: str, outcome: Outcome, seconds: float) -> None:
        note(f"{name}: {outcome.state}, {outcome.text} ({seconds:.1f} s)")

    return tell
