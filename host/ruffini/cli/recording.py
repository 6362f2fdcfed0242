"""Verbs for recordings: play them as a sensor, write them as tables, look at them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ruffini.cli.common import JsonFlag, emit, note
from ruffini.errors import InputError
from ruffini.older_python import StrEnum

FileArgument = Annotated[Path, typer.Argument(help="MCAP file of `ruffini record` or of the page.")]
SensorOption = Annotated[
    int | None, typer.Option("--sensor", min=0, max=254, help="Which sensor of a device with several.")
]
ForceOption = Annotated[bool, typer.Option("--force", help="Replace an existing file.")]


class Format(StrEnum):
    """What `export` writes."""

    csv = "csv"
    hdf5 = "hdf5"
    npz = "npz"
    parquet = "parquet"


def replay(
    file: FileArgument,
    speed: Annotated[float, typer.Option(min=0.01, max=1000.0, help="2 plays twice as fast.")] = 1.0,
    loop: Annotated[bool, typer.Option("--loop", help="Begin again at the end.")] = False,
    text: Annotated[
        bool, typer.Option("--text", help="No port: each frame as `monitor` shows it, as fast as can be.")
    ] = False,
    json_: JsonFlag = False,
) -> None:
    """Play a recording as a sensor on a serial port of its own, all marked REPLAY; starts when a host listens."""
    from ruffini.record import Recording

    recording = Recording(file)
    if text:
        from ruffini.cli.monitor import show

        for frame in recording.frames(partial=True):
            show(frame, as_json=json_)
    else:
        from ruffini.record.replay import ReplayedSensor

        with ReplayedSensor(recording, speed=speed, is_loop=loop) as sensor:
            emit({"port": sensor.port, "serial": recording.hello.device_serial}, json_, f"link: {sensor.port}")
            note(f"`ruffini --port {sensor.port} view` shows it; stop with Ctrl-C")
            sensor.run()
            if sensor.n_dropped:
                note(f"{sensor.n_dropped} results were left out: the host did not read them in time")
    for problem in recording.problems:
        note(problem)


def export(
    file: FileArgument,
    out: Annotated[
        Path | None, typer.Option("--out", help="Default: the recording's name with the format's end.")
    ] = None,
    format_: Annotated[Format, typer.Option("--format", help="CSV and Parquet have no fields.")] = Format.csv,
    sensor: SensorOption = None,
    force: ForceOption = False,
    json_: JsonFlag = False,
) -> None:
    """Write a recording as a table: a row for each frame; HDF5 and NPZ with the fields."""
    from ruffini.record import Recording
    from ruffini.record.export import export as write

    out = out or file.with_suffix("." + format_.value)
    _check_out(file, out, force=force)
    recording = Recording(file)
    counts = write(recording, out, format_.value, sensor)
    for problem in recording.problems:
        note(problem)
    fields = f", {counts['fields']} fields" if format_ in (Format.hdf5, Format.npz) else ", no fields (--format hdf5)"
    emit(
        {"file": str(out), **counts, "problems": recording.problems}, json_, f"{out}: {counts['frames']} frames{fields}"
    )


def plot(
    file: FileArgument,
    out: Annotated[Path | None, typer.Option("--out", help="Default: the recording's name with .html.")] = None,
    sensor: SensorOption = None,
    force: ForceOption = False,
    json_: JsonFlag = False,
) -> None:
    """A page of figures: forces, the field at its peak, contacts, rate, gaps and latency."""
    from ruffini.record import Recording
    from ruffini.record.plot import plot as write

    out = out or file.with_suffix(".html")
    _check_out(file, out, force=force)
    recording = Recording(file)
    said = write(recording, out, sensor)
    for problem in recording.problems:
        note(problem)
    rate = "" if said["frames_per_s"] is None else f", {said['frames_per_s']} a second"
    emit(said, json_, f"{out}: {said['frames']} frames{rate}, {said['missing_frames']} missing, "
                      f"largest force {said['largest_force_n']} N")  # fmt: skip


def recover(
    file: FileArgument,
    out: Annotated[Path, typer.Argument(help="File to write.")],
    force: ForceOption = False,
    json_: JsonFlag = False,
) -> None:
    """Write what can be read of a spoilt or cut-off recording as a whole file, and report what is lost."""
    from ruffini.record import Recording
    from ruffini.record.recover import recover as write

    _check_out(file, out, force=force)
    recording = Recording(file)
    counts = write(recording, out)
    for problem in recording.problems:
        note(problem)
    emit(
        {"file": str(out), **counts, "problems": recording.problems},
        json_,
        f"{out}: {counts['messages']} messages, {counts['frames']} frames, problems: {len(recording.problems)}",
    )


def _check_out(file: Path, out: Path, *, force: bool) -> None:
    """Raises InputError if `out` must not be written: it is the input, or exists and `force` is not given."""
    if out.exists() and out.samefile(file):
        raise InputError(f"{out} is the recording itself: choose another name")
    if out.exists() and not force:
        raise InputError(f"{out} exists: choose another name, or give --force")
