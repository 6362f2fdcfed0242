"""ruffini board eeprom: which board, which gel."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ruffini.cli.common import JsonFlag, emit
from ruffini.errors import InputError, RefusedError
from ruffini.older_python import StrEnum

if TYPE_CHECKING:
    from ruffini.device.eeprom import Eeprom, Identity


class Kind(StrEnum):
    """Whose EEPROM it is."""

    board = "board"
    gel = "gel"


KindOption = Annotated[Kind, typer.Option("--kind", help="Whose it is.")]
BusOption = Annotated[Path, typer.Option("--bus", help="I2C bus.")]
AddressOption = Annotated[str, typer.Option("--address", help="On the bus, e.g. 0x50.")]
SizeOption = Annotated[int, typer.Option("--address-bytes", min=1, max=2, help="1 up to 24C02, 2 from 24C32 on.")]


@contextlib.contextmanager
def _open(bus: Path, address: str, address_bytes: int) -> Iterator[Eeprom]:
    from ruffini.device import eeprom

    try:
        number = int(address, 0)
    except ValueError:
        number = -1
    if not 8 <= number <= 0x77:
        raise InputError(f"--address {address}: give 0x08 to 0x77")
    with contextlib.closing(eeprom.open_bus(bus)) as opened:
        yield eeprom.Eeprom(opened, number, address_bytes)


def _line(identity: Identity) -> str:
    return "  ".join(f"{name} {text}" for name, text in asdict(identity).items() if text)


def _read(kind: Kind, bus: Path, address: str, address_bytes: int, json_: bool) -> None:
    with _open(bus, address, address_bytes) as memory:
        identity = memory.identity(kind.value)
    emit({"kind": kind.value, **asdict(identity)}, json_, _line(identity))


class Action(StrEnum):
    """What is done with it."""

    read = "read"
    write = "write"


def eeprom(
    action: Annotated[Action, typer.Argument(help="read or write.")],
    serial: Annotated[str | None, typer.Option("--serial", help="1 to 23 letters, digits, - _ .")] = None,
    name: Annotated[str, typer.Option("--name", help="Of a board its folder's name, of a gel its type.")] = "",
    revision: Annotated[str, typer.Option("--revision")] = "",
    made: Annotated[str, typer.Option("--made", help="When, e.g. 2026-11.")] = "",
    kind: KindOption = Kind.gel,
    bus: BusOption = Path("/dev/i2c-1"),
    address: AddressOption = "0x50",
    address_bytes: SizeOption = 1,
    yes: Annotated[bool, typer.Option("--yes", help="Replace another identity.")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Write nothing.")] = False,
    json_: JsonFlag = False,
) -> None:
    """Read it, or write an identity and read it back; one that is there already is only replaced with --yes."""
    if action is Action.read:
        _read(kind, bus, address, address_bytes, json_)
        return
    if serial is None:
        raise InputError("board eeprom write needs the identity's --serial: give it")
    from ruffini.device import eeprom

    wanted = eeprom.Identity(serial, name, revision, made)
    data = eeprom.encode(wanted, kind.value)
    with _open(bus, address, address_bytes) as memory:
        try:
            before = memory.identity(kind.value)
        except InputError:  # empty, or something else
            before = None
        if before is not None and before != wanted and not yes:
            raise RefusedError(f"the EEPROM is that of {_line(before)}: --yes replaces it")
        if before != wanted and not dry_run:
            memory.write(data)
    emit({"kind": kind.value, "before": asdict(before) if before else None, "bytes": data.hex(), "dry_run": dry_run,
          **asdict(wanted)}, json_, ("would be " if dry_run else "") + _line(wanted))  # fmt: skip
