"""Verbs that talk to a sensor."""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ruffini.cli.common import RESUME_S, JsonFlag, ResumeOption, Settings, emit, note
from ruffini.cli.own_camera import own_camera
from ruffini.errors import InputError, NoDeviceError

if TYPE_CHECKING:
    from ruffini.boards import Board
    from ruffini.device import Connection
    from ruffini.device.results import Image
    from ruffini.wire import Frame, Schema


def common_options(
    context: typer.Context,
    port: Annotated[str | None, typer.Option(envvar="RUFFINI_PORT", help="Serial port of the sensor.")] = None,
    serial: Annotated[str | None, typer.Option(envvar="RUFFINI_SERIAL", help="Serial number of the sensor.")] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Results only.")] = False,
    no_progress: Annotated[bool, typer.Option("--no-progress", help="No progress bars.")] = False,
    camera: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|VIDEO|FOLDER",
            help="Instead of --port: a camera at this computer, as for `ruffini live` and with its calibration; the "
            "firmware runs here until the verb ends.",
        ),
    ] = None,
    board: Annotated[
        str | None, typer.Option(help="With --camera: board name or folder, where the camera does not tell it.")
    ] = None,
) -> None:
    """Options before the verb."""
    Settings.port, Settings.serial = port, serial
    Settings.quiet, Settings.progress = quiet, not no_progress
    is_named = any(str(context.get_parameter_source(name)).endswith("COMMANDLINE") for name in ("port", "serial"))
    if camera is not None and is_named:
        raise InputError("--camera: give it alone, or --port or --serial for a sensor that runs its own firmware")
    if camera is not None:
        Settings.port, Settings.serial = context.with_resource(own_camera(camera, board)), None
        if board is not None:
            context.default_map = defaults_of_verbs(board)
    elif board is not None:
        raise InputError("--board before the verb needs --camera: a sensor on a port tells its board itself")


def defaults_of_verbs(board: str) -> dict[str, Any]:
    """Defaults of the verbs that take a board, where one is given before them (click's default_map)."""
    return {"cal": {verb: {"board": board} for verb in ("auto", "collect", "fit")}}


def open_sensor() -> Connection:
    """The sensor that the global options choose."""
    from ruffini.device import connect

    return connect(Settings.port, Settings.serial)


def devices(json_: JsonFlag = False) -> None:
    """List the sensors that answer."""
    from ruffini.device import Connection
    from ruffini.device.choice import NOTHING_FOUND
    from ruffini.device.namesakes import namesakes
    from ruffini.device.ports import candidate_ports
    from ruffini.errors import RuffiniError

    ports = Settings.port.split(",") if Settings.port else candidate_ports()
    rows: list[dict[str, Any]] = []
    for port in ports:
        try:
            with Connection(port) as sensor:
                boards = [s.board for s in sensor.hello.sensors]
                rows.append({"port": port, "serial": sensor.serial_number, "boards": boards})
        except RuffiniError as error:
            rows.append({"port": port, "error": str(error)})
    text = "\n".join(f"{r['port']}  " + (r.get("error") or f"{r['serial']}  {', '.join(r['boards'])}") for r in rows)
    if not any("serial" in r for r in rows):
        raise NoDeviceError(text or NOTHING_FOUND)
    mixed_up = namesakes([(r["port"], r["serial"]) for r in rows if "serial" in r])
    emit({"devices": rows, "same_serial": mixed_up}, json_, "\n".join([text, *mixed_up]))


def info(json_: JsonFlag = False) -> None:
    """Who the sensor is, what it is calibrated for, how it fares, and how its learned network does."""
    from ruffini.device import NetworkState
    from ruffini.device.health import health_words, last_run_words, left_out_words, part_of, time_words

    with open_sensor() as sensor:
        hello, status = sensor.hello, sensor.status()
        clock = sensor.read_clock()
        health = sensor.schema.enum_names("HealthBit", status.health)
    now = None if not clock.n_exchanges else clock.to_host(clock.latest_us)
    network = NetworkState.from_status(status)
    rows = []
    for s in hello.sensors:
        c = s.calibration
        rows.append(
            {
                "sensor": s.sensor,
                "board": s.board,
                "product": s.product,
                "image": f"{s.image_width_px}x{s.image_height_px}",
                "grid": [s.grid_n_x, s.grid_n_y],
                "markers": s.n_markers,
                "stages": list(s.stages),
                "not_measured": list(s.not_measured),
                "calibration": {
                    "present": c.present,
                    "sha256": c.sha256.hex(),
                    "created_utc": c.created_utc,
                    "kinds": ",".join(c.kinds),
                    "key_id": c.key_id,
                    "development_key": c.development_key,
                    "on_trial": c.on_trial,
                    "gates": c.summary,
                },
            }
        )
    result = {
        "port": sensor.port, "serial": hello.device_serial, "firmware": hello.firmware_version,
        "protocol": hello.protocol_version, "sensors": rows, "network": None if network is None else asdict(network),
        "needs_key": getattr(hello, "needs_key", False), "key_ids": list(getattr(hello, "key_ids", [])),
        "clock": None if now is None else {"host_minus_sensor_ns": now.ns - 1000 * clock.latest_us,
                                           "error_ns": now.error_ns},
        "health": health, "store_problem": getattr(status, "store_problem", ""), "last_run": last_run_words(status),
        "scheduling": part_of(status, "scheduling"), "line_latency": part_of(status, "line_latency"),
        "frames_left_out": getattr(status, "frames_left_out", 0),
    }  # fmt: skip
    lines = [f"{sensor.port}  serial {hello.device_serial}  firmware {hello.firmware_version}"]
    if now is not None:
        lines.append(f"  clock: {(now.ns - 1000 * clock.latest_us) * 1e-9:.6f} s behind the host's, +- "
                     f"{now.error_ns / 1e3:.0f} us")  # fmt: skip
    owners = f"its owners ({', '.join(result['key_ids'])})" if result["needs_key"] else "ANYBODY ON THE LINE"
    lines.append(f"  changed by: {owners}")
    for r in rows:
        c = r["calibration"]
        state = f"{c['kinds']} of {c['created_utc']}" if c["present"] else "none: forces are not measured"
        lines.append(
            f"  sensor {r['sensor']}: {r['board']} ({r['product']}), {r['image']} px, "
            f"grid {r['grid'][0]}x{r['grid'][1]}"
        )
        lines.append(
            f"    calibration: {state}"
            + ("  DEVELOPMENT KEY" if c["development_key"] else "")
            + ("  ON TRIAL" if c["on_trial"] else "")
        )
    if network is not None:
        lines.append(f"    network: {network.text()}")
    lines += [f"  {words}" for words in time_words(status) + left_out_words(status)]
    lines += [f"  health: {words}" for words in health_words(health)]
    problem = getattr(status, "store_problem", "")
    lines += [f"  store: {problem}"] if problem else []
    if result["last_run"]:
        lines.append(f"  the last run {result['last_run']}")
    emit(result, json_, "\n".join(lines))


def record(
    out: Annotated[Path, typer.Argument(help="MCAP file to write.")],
    n: Annotated[int, typer.Option("--n", min=0, help="Stop after so many frames (0 = until interrupted).")] = 0,
    image_every: Annotated[
        int, typer.Option(min=0, help="Every so many frames also the camera image (0 = never).")
    ] = 0,
    residual_every: Annotated[
        int, typer.Option(min=0, help="Every so many frames also what the forces do not explain (0 = never).")
    ] = 0,
    ros: Annotated[bool, typer.Option("--ros/--no-ros", help="Wrench and field as ROS 2 messages, too.")] = True,
    resume: ResumeOption = RESUME_S,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
    json_: JsonFlag = False,
) -> None:
    """Record the stream to MCAP: every message as protobuf with its schema, and the raw bytes."""
    from ruffini.record import record_stream

    if out.exists() and not force:
        raise InputError(f"{out} exists: choose another name, or give --force")
    with open_sensor() as sensor:
        note(f"recording {sensor.port} to {out}, stop with Ctrl-C")
        sensor.on_damage = note
        ended: list[str] = []
        counts = record_stream(
            sensor, out, n_frames=n, image_every=image_every, residual_every=residual_every, has_ros=ros,
            resume_s=resume, on_gap=lambda gap: note(f"{sensor.port}: {gap}"), on_end=ended.append,
        )  # fmt: skip
    if ended:
        raise NoDeviceError(ended[0])
    repeated = f", {counts['REPEATED']} repeated results" if "REPEATED" in counts else ""
    emit(
        {"file": str(out), "messages": counts},
        json_,
        f"{out}: {sum(counts.values())} messages, {counts.get('WRENCH', 0)} frames{repeated}",
    )


def _camera_picture(out: Path, image: Image, board: Board, schema: Schema, frame: Frame, json_: bool) -> None:
    """Write the camera's frame at the board's size, so that its pixels are those of board.toml."""
    import cv2
    import numpy as np

    from ruffini.files import write_whole

    size = (board.camera.width_px, board.camera.height_px)
    step = image.step_px
    whole = cv2.warpAffine(
        image.pixels, np.array([[step, 0.0, 0.0], [0.0, step, 0.0]]), size, borderMode=cv2.BORDER_REPLICATE
    )
    write_whole(out, cv2.imencode(".png", whole)[1].tobytes())
    flags = schema.enum_names("FlagBit", image.flags)
    decimated = f" (every {image.step_px}th pixel was sent)" if image.step_px > 1 else ""
    emit(
        {"file": str(out), "frame": image.frame, "flags": flags, "step_px": image.step_px,
         "simulated": frame.is_simulated, "replay": frame.is_replay},
        json_,
        f"{out}: camera frame {image.frame}, {size[0]}x{size[1]} px{decimated}",
    )  # fmt: skip


def _where_pressed(sigma: Any, force: Any) -> Any:
    """Mean standard deviation (3,) of the nodes that press; of all where none does."""
    pressed = force[..., 2] < 0
    return sigma[pressed if pressed.any() else slice(None)].reshape(-1, 3).mean(axis=0)


def snapshot(
    out: Annotated[Path, typer.Option("--out", help="PNG to write.")] = Path("snapshot.png"),
    json_: JsonFlag = False,
) -> None:
    """A picture of the field as it is now; the camera's, pixel for pixel, where the board has no field."""
    from ruffini.boards import parse_board
    from ruffini.demo.pictures import field_over_frame
    from ruffini.demo.view import node_pixels, node_places
    from ruffini.device.connection import IMAGE_S, SILENCE_S
    from ruffini.device.results import INVALID, NOT_MEASURED, RESULTS, VALID
    from ruffini.errors import NoDeviceError

    with open_sensor() as sensor:
        board = parse_board(sensor.hello.sensors[0].board_toml, sensor.port)
        has_field = board.writes("node_forces")
        sensor.subscribe(field=int(has_field), image=1)
        got: dict[str, dict[int, Any]] = {**({"FIELD": {}} if has_field else {}), "IMAGE": {}}
        end_s = time.monotonic() + IMAGE_S
        for frame, message in sensor.stream(timeout_s=SILENCE_S):
            name = sensor.schema.type_name(frame.type)
            if time.monotonic() > end_s:
                lacking = [kind.lower() for kind, there in got.items() if not there]
                lacking = lacking or ["image of a frame with a field"]
                raise NoDeviceError(f"{sensor.port}: no {' and no '.join(lacking)} came: does this sensor send it?")
            if name not in got:
                continue
            result = RESULTS[name].from_message(message)
            got[name][result.frame] = result
            both = sorted(set.intersection(*(set(there) for there in got.values())))
            if both:
                break
        else:
            raise NoDeviceError(f"{sensor.port}: no frame for {SILENCE_S:.0f} s: is the camera running?")
    if not has_field:
        return _camera_picture(out, got["IMAGE"][both[0]], board, sensor.schema, frame, json_)
    field, image = got["FIELD"][both[0]], got["IMAGE"][both[0]]
    flags = sensor.schema.enum_names("FlagBit", field.flags)
    badges = [*(["SIMULATED"] if frame.is_simulated else []), *(f.removeprefix("FLAG_") for f in flags)]
    if INVALID in field.validity:
        badges.insert(0, "INVALID")
    title = f"{board.name}, frame {field.frame} {' '.join(badges)}"
    field_over_frame(out, image.pixels, node_pixels(board) / image.step_px, node_places(board), field.raw_force,
                     title=title, slip=field.slip, z_calibrated=field.validity[2] in (VALID, INVALID))  # fmt: skip
    total = field.raw_force.sum(axis=(0, 1)).tolist()
    force = [None if v == NOT_MEASURED else f for f, v in zip(total, field.validity, strict=True)]
    sigma = None if field.sigma is None else _where_pressed(field.sigma, field.raw_force).tolist()
    stated = "not measured" if sigma is None else "/".join(f"{1e3 * s:.2f}" for s in sigma) + " mN"
    emit(
        {"file": str(out), "frame": field.frame, "force_n": force, "validity": list(field.validity), "flags": flags,
         "node_sigma_n": sigma, "sigma_validity": field.sigma_validity,
         "nodes": None if field.slip is None else {"stick": int((field.slip == 1).sum()),
                                                   "slip": int((field.slip == 2).sum())},
         "simulated": frame.is_simulated, "replay": frame.is_replay},
        json_,
        " ".join([str(out), *badges, f"(sigma of a node x/y/z: {stated})"]),
    )  # fmt: skip
