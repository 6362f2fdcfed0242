"""ruffini key: owners' signing keys."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ruffini.cli.common import JsonFlag, emit

NAME = typer.Argument(help="Name of the key.")
MAX_VERSION, MAX_EPOCH = 10**12 - 1, 10**9  # as the firmware reads them: proto/CALIBRATION.md


def new(name: Annotated[str, NAME], json_: JsonFlag = False) -> None:
    """Make a key; its secret half stays here."""
    from ruffini.calibrate import keys

    key = keys.make(name)
    emit({"name": name, "key_id": key.key_id, "folder": str(keys.folder())}, json_,
         f"key {name} ({key.key_id}) in {keys.folder()}: keep {name}.key, enrol {name} on your sensors")  # fmt: skip


def show(json_: JsonFlag = False) -> None:
    """The keys that are here."""
    from ruffini.calibrate import keys

    rows = [
        {"name": k.name, "key_id": k.key_id, "public": k.public.hex(), "can_sign": k.can_sign} for k in keys.known()
    ]
    text = "\n".join(f"{r['key_id']}  {r['name']}" + ("" if r["can_sign"] else "  (public half only)") for r in rows)
    emit({"folder": str(keys.folder()), "keys": rows}, json_, text or f"no keys in {keys.folder()}: `ruffini key new`")


def enrol(
    name: Annotated[str, NAME],
    into: Annotated[Path, typer.Argument(help="Folder that `ruffinid --keys` names: on its card, or on the sensor.")],
    json_: JsonFlag = False,
) -> None:
    """Put the public half where a sensor reads its keys; it counts from the sensor's next start."""
    from ruffini.calibrate import keys

    target = keys.enrol(name, into)
    emit({"file": str(target)}, json_, f"{target}: calibrations signed by {name} are taken from the next start on")


def sign(
    file: Annotated[Path, typer.Argument(help="Calibration file.")],
    out: Annotated[Path, typer.Option("--out", help="File to write.")],
    name: Annotated[
        str | None, typer.Option("--key", envvar="RUFFINI_KEY", help="Name of the key (without: the development key).")
    ] = None,
    version: Annotated[
        int | None, typer.Option(min=1, max=MAX_VERSION, help="Number of this calibration; sensors go forward.")
    ] = None,
    epoch: Annotated[
        int | None,
        typer.Option(min=0, max=MAX_EPOCH, help="Security epoch; a sensor that reached one never takes a lower one."),
    ] = None,
    sensor: Annotated[
        str | None, typer.Option(help="Serial number of the only sensor that may take it; '*': any.")
    ] = None,
    allow_older: Annotated[
        bool, typer.Option("--allow-older", help="Sensors take it though a newer version is in force.")
    ] = False,
    allow_jump: Annotated[
        bool, typer.Option("--allow-jump", help="Sensors take it though version or epoch are far ahead.")
    ] = False,
    json_: JsonFlag = False,
) -> None:
    """Sign a calibration with an owner's key, and say for whom it is and what it may follow."""
    from ruffini.calibrate import keys
    from ruffini.files import write_whole

    said = {"version": version, "security_epoch": epoch, "sensor_serial": sensor,
            "allow_older": "1" if allow_older else "0", "allow_jump": "1" if allow_jump else "0"}  # fmt: skip
    changes = {key: str(value) for key, value in said.items() if value is not None}
    signed = keys.sign(keys.read_verified(file), name, changes)
    write_whole(out, signed.data)
    manifest = {key: signed.metadata.get(key, "") for key in said}
    text = (
        f"{out}: signed by {name or 'the development key'} ({signed.metadata['key_id']}), version "
        f"{manifest['version']}, epoch {manifest['security_epoch']}, for sensor {manifest['sensor_serial']}"
    )
    emit(
        {"file": str(out), "key_id": signed.metadata["key_id"], "sha256": signed.sha256.hex(), **manifest}, json_, text
    )
