"""ruffini doctor: what is missing on this computer."""

from __future__ import annotations

from dataclasses import asdict

import typer

from ruffini.cli.common import JsonFlag, Settings, emit


def doctor(json_: JsonFlag = False) -> None:
    """Look at library, udev rules, ports, permissions, sensors; name each remedy. Exit code 1 if one failed."""
    from ruffini.device.doctor import examine

    checks = examine(Settings.port.split(",") if Settings.port else None)
    is_ok = all(check.state != "failed" for check in checks)
    lines = [f"{c.state}  {c.name}: {c.found}" + (f"\n    {c.remedy}" if c.remedy else "") for c in checks]
    emit({"ok": is_ok, "checks": [asdict(c) for c in checks]}, json_, "\n".join(lines))
    if not is_ok:
        raise typer.Exit(1)
