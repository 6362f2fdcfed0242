"""`ruffini rerun`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ruffini.cli.common import JsonFlag, Settings, emit, note


def rerun(
    save: Annotated[Path | None, typer.Option(help="Into a file (.rrd) instead of a viewer.")] = None,
    connect: Annotated[
        str | None, typer.Option(help="A viewer that runs already, e.g. rerun+http://10.0.0.2:9876/proxy.")
    ] = None,
    image: Annotated[int, typer.Option(min=0, help="Every n-th picture of the camera, too (0 = none).")] = 0,
    arrow_m_per_n: Annotated[float, typer.Option(min=0, help="Length of a node's arrow, metres a newton.")] = 0.2,
    n_frames: Annotated[int | None, typer.Option(min=1, help="End after so many frames.")] = None,
    json_: JsonFlag = False,
) -> None:
    """The field, wrench and depth of a sensor in Rerun's viewer (extra [rerun]), until Ctrl-C."""
    import signal
    import threading

    import ruffini
    from ruffini.errors import InputError, RuffiniError
    from ruffini.extras import missing
    from ruffini.ros.messages import ros_name
    from ruffini.view.rerun_sink import RerunSink

    if save is not None and connect is not None:
        raise InputError("--save and --connect: choose one")
    try:
        import rerun as rr
    except ImportError as error:
        raise missing("ruffini rerun", "rerun") from error
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    with ruffini.connect(Settings.port, Settings.serial, contacts=0, learned=0, image=image, on_note=note) as sensor:
        stream = rr.RecordingStream("ruffini")
        if save is not None:
            stream.save(save)
        elif connect is not None:
            stream.connect_grpc(connect)
        else:
            stream.spawn()
        nodes = {}
        for number in sensor.call(lambda c: [s.sensor for s in c.hello.sensors]):
            try:
                nodes[number] = sensor.nodes(number)
            except RuffiniError:
                continue  # a board without a field
        sink = RerunSink(rr, stream, ros_name(sensor.serial_number), nodes, arrow_m_per_n=arrow_m_per_n)
        frames, n_done = sensor.frames(partial=True), 0
        while not stop.is_set() and (n_frames is None or n_done < n_frames):
            if (frame := frames.get(0.2)) is not None:
                sink.put(frame)
                n_done += 1
        stream.flush()
        stream.disconnect()
    emit(
        {"frames": n_done, "file": str(save) if save else None},
        json_,
        f"{n_done} frames" + (f": {save}" if save else ""),
    )
