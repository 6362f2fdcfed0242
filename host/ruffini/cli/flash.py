"""ruffini cal flash, cal undo: which calibration is in force on a sensor."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ruffini.cli.common import JsonFlag, emit, note, progress_bar
from ruffini.cli.device import open_sensor

if TYPE_CHECKING:
    from ruffini.calibrate.container import CalibrationFile


def flash(
    files: Annotated[list[Path], typer.Argument(help="Calibration files; several are merged, later ones win.")],
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Check everything, write nothing.")] = False,
    diff: Annotated[
        bool, typer.Option("--diff", help="Say what differs from what is in force there, write nothing.")
    ] = False,
    backup: Annotated[
        Path | None, typer.Option(help="Folder for what is in force there now, read back before it is replaced.")
    ] = None,
    no_backup: Annotated[bool, typer.Option("--no-backup", help="Do not read back what is in force there.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Also where its report fails its gates.")] = False,
    key: Annotated[
        str | None, typer.Option("--key", envvar="RUFFINI_KEY", help="Sign it with this key first (`ruffini key`).")
    ] = None,
    json_: JsonFlag = False,
) -> None:
    """Put a calibration in force; success means read back, tried on frames, ACTIVE. `cal undo` takes it back."""
    from ruffini.boards import parse_board
    from ruffini.calibrate import container, keys
    from ruffini.calibrate.gates import check_gates
    from ruffini.device import backup as backups

    read = [keys.read_verified(f) for f in files]
    file = container.merge(read) if len(read) > 1 else read[0]
    file = keys.sign(file, key) if key else file
    remarks = [check_gates(one, force=force) for one in read]
    with open_sensor() as sensor:
        board = parse_board(sensor.hello.sensors[0].board_toml, sensor.port)
        container.check_board(file, board)
        for remark in filter(None, remarks):
            note(remark)
        active = sensor.hello.sensors[0].calibration
        state = "same" if active.sha256 == file.sha256 else "diff" if diff else "dry-run" if dry_run else "active"
        result: dict[str, Any] = {"state": state, "sha256": file.sha256.hex(), "kinds": file.kinds}
        if state == "diff" or (state == "active" and active.present and not no_backup):
            with progress_bar("read back") as progress:
                before = sensor.read_calibration(progress)
        if state == "diff":
            _emit_difference(sensor.port, before, file, result, json_)
            return
        if state == "same" and not (diff or dry_run):  # sent again where a restart may not restore it
            sensor.flash(file.data, say=note)
        note(f"{sensor.port}: {', '.join(file.kinds)} for {board.name} replaces "
             + (f"{','.join(active.kinds)} of {active.created_utc}" if active.present else "nothing"))  # fmt: skip
        if state == "active":
            if active.present and not no_backup:
                kept = backups.keep(before, sensor.serial_number, backup or backups.folder())
                result["backup"] = str(kept)
                note(f"{sensor.port}: what is in force there is kept in {kept}")
            with progress_bar("flash") as progress:
                sensor.flash(file.data, progress, note)
    words = {"same": "already in force", "dry-run": "dry run, nothing written",
             "active": "in force; what was before is kept there: `ruffini cal undo` puts it back"}  # fmt: skip
    emit(result, json_, f"{sensor.port}: {words[state]}")


def _emit_difference(port: str, before: bytes, file: CalibrationFile, result: dict[str, Any], json_: bool) -> None:
    """What of the calibration in force the file would change."""
    from ruffini.calibrate import container
    from ruffini.calibrate.difference import differences

    found = differences(container.unpack(before, port) if before else None, file)
    rows = [asdict(difference) for difference in found]
    text = "\n".join([f"{port}: {len(found)} differences, nothing written", *(f"  {d}" for d in found)])
    emit({**result, "differences": rows}, json_, text)


def undo(json_: JsonFlag = False) -> None:
    """Put the calibration in force that was so before the last flash; once more takes that back."""
    with open_sensor() as sensor:
        replaced = sensor.hello.sensors[0].calibration
        sensor.undo_flash()
        active = sensor.hello.sensors[0].calibration
    emit({"state": "active", "sha256": active.sha256.hex(), "replaced_sha256": replaced.sha256.hex(),
          "created_utc": active.created_utc, "kinds": list(active.kinds)}, json_,
         f"{sensor.port}: " + (f"{', '.join(active.kinds)} of {active.created_utc} in force again" if active.present
                               else "no calibration in force, as before"))  # fmt: skip
