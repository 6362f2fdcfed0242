"""ruffini key: owners' signing keys."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ruffini.cli.common import JsonFlag, emit

app = typer.Typer(
    help="Signing keys: new, show, enrol, sign. A sensor with an enrolled key takes that owner's files only."
)
NAME = typer.Argument(help="Name of the key.")


@app.command("new")
def new(name: Annotated[str, NAME], json_: JsonFlag = False) -> None:
    """Make a key; its secret half stays here."""
    from ruffini.calibrate import keys

    key = keys.make(name)
    emit({"name": name, "key_id": key.key_id, "folder": str(keys.folder())}, json_,
         f"key {name} ({key.key_id}) in {keys.folder()}: keep {name}.key, enrol {name} on your sensors")  # fmt: skip


@app.command("show")
def show(json_: JsonFlag = False) -> None:
    """The keys that are here."""
    from ruffini.calibrate import keys

    rows = [
        {"name": k.name, "key_id": k.key_id, "public": k.public.hex(), "can_sign": k.can_sign} for k in keys.known()
    ]
    text = "\n".join(f"{r['key_id']}  {r['name']}" + ("" if r["can_sign"] else "  (public half only)") for r in rows)
    emit({"folder": str(keys.folder()), "keys": rows}, json_, text or f"no keys in {keys.folder()}: `ruffini key new`")


@app.command("enrol")
def enrol(
    name: Annotated[str, NAME],
    into: Annotated[Path, typer.Argument(help="Folder that `ruffinid --keys` names: on its card, or on the sensor.")],
    json_: JsonFlag = False,
) -> None:
    """Put the public half where a sensor reads its keys; it counts from the sensor's next start."""
    from ruffini.calibrate import keys

    target = keys.enrol(name, into)
    emit({"file": str(target)}, json_, f"{target}: calibrations signed by {name} are taken from the next start on")


@app.command("sign")
def sign(
    file: Annotated[Path, typer.Argument(help="Calibration file.")],
    name: Annotated[str, typer.Option("--key", envvar="RUFFINI_KEY", help="Name of the key.")],
    out: Annotated[Path, typer.Option("--out", help="File to write.")],
    json_: JsonFlag = False,
) -> None:
    """Sign a calibration with an owner's key."""
    from ruffini.calibrate import keys
    from ruffini.files import write_whole

    signed = keys.sign(keys.read_verified(file), name)
    write_whole(out, signed.data)
    emit({"file": str(out), "key_id": signed.metadata["key_id"], "sha256": signed.sha256.hex()}, json_,
         f"{out}: signed by {name} ({signed.metadata['key_id']})")  # fmt: skip
