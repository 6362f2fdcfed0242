"""`ruffini view`."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

import typer

from ruffini.cli.common import JsonFlag, Settings, emit, note
from ruffini.cli.device import open_sensor

HTTP_PORT = 8451
WATCH_S = 0.2  # between two looks whether the page has still something to show


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
    from ruffini.device.ports import candidate_ports
    from ruffini.errors import NoDeviceError
    from ruffini.view.server import page_folder

    page_folder()
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
        show_page(ports, http_port, no_browser=no_browser, json_=json_)


def show_page(
    ports: Sequence[str],
    http_port: int,
    *,
    no_browser: bool,
    json_: bool,
    is_over: Callable[[], bool] = lambda: False,
    folder: Path | None = None,
) -> None:
    """Serve the page of these ports until a signal comes or `is_over`; prints its address, and opens it.

    folder : where calibrations made in the page are kept; None: found by board and serial number.
    """
    import asyncio
    import signal
    import webbrowser

    from ruffini.view.calibrating_line import CalibratingLine
    from ruffini.view.server import serve

    def ready(address: str) -> None:
        emit({"address": address}, json_, address)
        note("stop with Ctrl-C")
        if not no_browser:
            webbrowser.open(address)

    async def until_stopped() -> None:
        stop = asyncio.Event()
        for number in (signal.SIGINT, signal.SIGTERM):
            asyncio.get_running_loop().add_signal_handler(number, stop.set)

        async def watch() -> None:
            while not is_over():
                await asyncio.sleep(WATCH_S)
            stop.set()

        watching = asyncio.create_task(watch())
        await serve([CalibratingLine(port, folder) for port in ports], http_port, ready, stop, note)
        watching.cancel()

    asyncio.run(until_stopped())
