"""`ruffini ros2`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ruffini.cli.common import BoardOption, JsonFlag, Settings, emit, note
from ruffini.older_python import StrEnum


class Through(StrEnum):
    """How messages get into ROS."""

    zenoh = "zenoh"
    rclpy = "rclpy"


def bridge(
    through: Annotated[
        Through, typer.Option(help="zenoh: for nodes with rmw_zenoh, no ROS install here; rclpy: an ordinary node.")
    ] = Through.zenoh,
    domain: Annotated[int, typer.Option(envvar="ROS_DOMAIN_ID", min=0, max=232, help="ROS domain.")] = 0,
    connect: Annotated[
        list[str] | None, typer.Option(help="zenoh: where a router or peer listens, e.g. tcp/10.0.0.2:7447.")
    ] = None,
    listen: Annotated[list[str] | None, typer.Option(help="zenoh: where to listen, e.g. tcp/0.0.0.0:7448.")] = None,
    n_frames: Annotated[int | None, typer.Option(min=1, help="End after so many frames.")] = None,
    residual_every: Annotated[
        int, typer.Option(min=0, help="Publish what the forces do not explain of each n-th frame (0 = never).")
    ] = 0,
    json_: JsonFlag = False,
) -> None:
    """Publish wrench, field, depth, contacts, learned quantities and health of a sensor until Ctrl-C."""
    import signal
    import threading

    import ruffini
    from ruffini.ros.bridge import Bridge
    from ruffini.ros.messages import ros_name
    from ruffini.ros.rclpy_node import RclpyNode
    from ruffini.ros.rmw_zenoh import LOCAL_ROUTER, ZenohNode, configuration

    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    config = configuration(connect or [LOCAL_ROUTER], listen or []) if through == Through.zenoh else None
    with ruffini.connect(Settings.port, Settings.serial, residual=residual_every, on_note=note) as sensor:
        name = ros_name(sensor.serial_number)
        with ZenohNode(name, config, domain=domain) if config is not None else RclpyNode(name) as node:
            relay = Bridge(sensor, node, note)
            note(f"{sensor.port}: publishing as /{name} through {through.value}; stop with Ctrl-C")
            relay.run(stop.is_set, n_frames)
    emit({"node": name, "frames": relay.n_frames}, json_, f"{relay.n_frames} frames published")


def urdf(
    board: BoardOption,
    name: Annotated[str, typer.Option(help="Prefix of the frames, as the bridge prints it: ruffini_SERIAL.")],
    json_: JsonFlag = False,
) -> None:
    """The frames of a board, for a robot's description."""
    from ruffini.boards import find_board
    from ruffini.ros.urdf import urdf as make_urdf

    text = make_urdf(find_board(board), name)
    emit({"urdf": text}, json_, text.rstrip("\n"))


def messages(
    out: Annotated[Path, typer.Argument(help="Folder of a workspace's sources; ruffini_msgs is put into it.")],
    json_: JsonFlag = False,
) -> None:
    """The sources of ruffini_msgs, for `colcon build`."""
    import shutil

    from ruffini.errors import InputError
    from ruffini.ros.cdr import SOURCES

    target = out / SOURCES.name
    if target.exists():
        raise InputError(f"{target} is there already: remove it first")
    shutil.copytree(SOURCES, target)
    emit({"folder": str(target)}, json_, f"{target}: now `colcon build --packages-select ruffini_msgs`")
