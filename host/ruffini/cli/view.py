"""`ruffini view`."""

from __future__ import annotations

import contextlib
from typing import Annotated

import typer

from ruffini.cli.common import JsonFlag, Settings, emit, note
from ruffini.cli.device import open_sensor

HTTP_PORT = 8451


def view(
    http_port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port of this computer for the page (0 = any that is free).")
    ] = HTTP_PORT,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Print the address and open nothing.")] = False,
    demo: Annotated[
        str | None,
        typer.Option(metavar="BOARD", help="Without a sensor: this board's SIMULATED pad, pressed again and again."),
    ] = None,
    json_: JsonFlag = False,
) -> None:
    """The live force field in a browser; several sensors: --port A,B."""
    note(f"view: preparing the SIMULATED {demo}" if demo else "view: looking for sensors")
    import asyncio
    import signal
    import webbrowser

    from ruffini.device.ports import candidate_ports
    from ruffini.errors import NoDeviceError
    from ruffini.view.line import SharedLine
    from ruffini.view.server import page_folder, serve

    page_folder()

    def ready(address: str) -> None:
        emit({"address": address}, json_, address)
        note("stop with Ctrl-C")
        if not no_browser:
            webbrowser.open(address)

    async def until_stopped(ports: list[str]) -> None:
        stop = asyncio.Event()
        for number in (signal.SIGINT, signal.SIGTERM):
            asyncio.get_running_loop().add_signal_handler(number, stop.set)
        await serve([SharedLine(port) for port in ports], http_port, ready, stop, note)

    with contextlib.ExitStack() as stack:
        if demo:
            from ruffini.view.demo import running_demo

            ports = [stack.enter_context(running_demo(demo))]
        elif Settings.serial:
            with open_sensor() as sensor:
                ports = [sensor.port]
        else:
            ports = Settings.port.split(",") if Settings.port else candidate_ports()
        if not ports:
            raise NoDeviceError("no sensor found: plug one in, name its port with --port, or try --demo BOARD")
        asyncio.run(until_stopped(ports))
