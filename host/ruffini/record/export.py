"""Recordings as tables: CSV and Parquet with a row for each frame, HDF5 and NPZ with the fields as well.

SI units, pad frame, forces ON the pad; what is not valid is NaN, with its validity beside it. Integers that are not
known are -1. Either is an empty cell in CSV.
"""

from __future__ import annotations

import csv
import itertools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.api.frame import SensorFrame
from ruffini.api.sensor import node_places, sensor_info
from ruffini.device.results import Field, valid_or_nan
from ruffini.errors import InputError
from ruffini.extras import missing
from ruffini.record.columns import contact_columns, learned_columns, softness_columns
from ruffini.record.recording import Recording

BLOCK = 256  # frames that are in memory at once; NPZ needs all
AXES = ("x", "y", "z")
NAN3 = (np.nan,) * 3
# Columns of several numbers: name of the array, names of the cells.
CELLS = {
    "force_n": [f"force_{a}_n" for a in AXES], "torque_nm": [f"torque_{a}_nm" for a in AXES],
    "validity": [f"validity_{w}_{a}" for w in ("force", "torque") for a in AXES],
    "sigma_force_n": [f"sigma_force_{a}_n" for a in AXES], "sigma_torque_nm": [f"sigma_torque_{a}_nm" for a in AXES],
}  # fmt: skip
# Integers that are -1 where they are not known.
UNKNOWN = ("host_monotonic_ns", "host_utc_ns", "host_time_error_ns", "n_contacts", "n_contacts_found", "n_missed",
           "contact_id", "learned_frame")  # fmt: skip
Block = dict[str, npt.NDArray[Any]]
# Values of nodes, cells and markers, for formats that hold arrays; None: the frame has none.
DENSE: dict[str, Callable[[SensorFrame], Any]] = {
    "field_force_n": lambda f: f.field and f.field.force,
    "field_sigma_n": lambda f: f.field and _valid_sigma(f.field),
    "field_displacement_m": lambda f: f.field and f.field.displacement,
    "field_slip": lambda f: f.field and f.field.slip,
    "field_residual": lambda f: f.residual and f.residual.residual,
    "depth_m": lambda f: f.depth and f.depth.depth,
    "marker_displacement_px": lambda f: f.markers and f.markers.displacement_px,
    "marker_rest_px": lambda f: f.markers and f.markers.rest_px,
    "marker_is_lost": lambda f: f.markers and f.markers.is_lost,
    "marker_quality": lambda f: f.markers and f.markers.quality,
    "marker_area_px2": lambda f: f.markers and f.markers.area_px2,
}


def export(recording: Recording, out: Path, kind: str, sensor: int | None = None) -> dict[str, int]:
    """Write all frames of one sensor.

    Returns
    -------
    dict
        frames: how many; fields: how many of them with a field that was written.

    Raises
    ------
    InputError
        Nothing to write, a sensor that is not there, several and no choice, or a library that is not installed.
    """
    sensor = chosen_sensor(recording, sensor)
    blocks = _blocks(recording, sensor)
    try:
        first = next(blocks)
    except StopIteration:
        raise InputError(f"{recording.path}: has no frame of sensor {sensor}") from None
    write = {"csv": _csv, "hdf5": _hdf5, "npz": _npz, "parquet": _parquet}[kind]
    temporary = out.with_name(out.name + ".part")
    counts = {"frames": 0, "fields": 0}

    def counted() -> Iterator[Block]:
        for block in itertools.chain([first], blocks):
            counts["frames"] += len(block["frame"])
            if "field_force_n" in block and kind in ("hdf5", "npz"):
                counts["fields"] += int(block["has_field"].sum())
            yield block

    try:
        write(temporary, counted(), _about(recording, sensor))
        temporary.replace(out)
    except OSError as error:
        raise InputError(f"{out}: cannot be written: {error.strerror or error}") from error
    finally:
        temporary.unlink(missing_ok=True)
    return counts


def chosen_sensor(recording: Recording, sensor: int | None) -> int:
    """The one that is asked for, or the only one."""
    if sensor is None:
        ids = [s.sensor for s in recording.hello.sensors]
        if len(ids) != 1:
            raise InputError(f"{recording.path}: has sensors {', '.join(map(str, ids))}: choose one with --sensor")
        return int(ids[0])
    return int(sensor_info(recording.hello, sensor, str(recording.path)).sensor)


def _about(recording: Recording, sensor: int) -> dict[str, Any]:
    """What goes with the columns: single things."""
    info = sensor_info(recording.hello, sensor, str(recording.path))
    flags = recording.schema.enum_names("FlagBit", 0xFFFFFFFF)
    return {
        "serial": recording.hello.device_serial, "board": info.board, "source": recording.path.name,
        "node_place_m": node_places(info), "flag_names": np.array(flags),
        "frame_of_reference": "origin: centre of the undeformed pad; x right, y down in the image, z out of the pad; "
        "forces ON the pad; NaN: not valid",
    }  # fmt: skip


def _blocks(recording: Recording, sensor: int) -> Iterator[Block]:
    frames = recording.frames(sensor, partial=True)
    head = list(itertools.islice(frames, BLOCK))
    shapes = {name: next((a.shape for f in head if (a := get(f)) is not None), None) for name, get in DENSE.items()}
    frames = itertools.chain(head, frames)
    while rows := list(itertools.islice(frames, BLOCK)):
        block = _columns([_row(recording, frame) for frame in rows])
        block.update({name: _dense(rows, DENSE[name], shape) for name, shape in shapes.items() if shape is not None})
        if shapes["field_force_n"] is not None:
            block["has_field"] = np.array([f.field is not None and f.field.raw_force.shape == shapes["field_force_n"]
                                           for f in rows])  # fmt: skip
        yield block


def _columns(rows: list[dict[str, Any]]) -> Block:
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


def _row(recording: Recording, frame: SensorFrame) -> dict[str, Any]:
    wrench, contacts = frame.wrench, frame.contacts
    sigma = None if wrench is None else wrench.sigma
    first = contacts.contacts[0] if contacts is not None and contacts.contacts else None
    covariance = None if wrench is None else wrench.covariance
    capture_us = round(frame.capture_s * 1e6)
    utc_ns = recording.utc_ns(capture_us)
    return {
        "frame": frame.number, "capture_us": capture_us, "host_monotonic_ns": frame.host_time_ns or -1,
        "host_utc_ns": -1 if utc_ns is None else utc_ns, "host_time_error_ns": frame.host_time_error_ns or -1,
        "force_n": NAN3 if wrench is None else wrench.force, "torque_nm": NAN3 if wrench is None else wrench.torque,
        "validity": (0,) * 6 if wrench is None else wrench.validity,
        "sigma_force_n": NAN3 if sigma is None else sigma[:3], "sigma_torque_nm": NAN3 if sigma is None else sigma[3:],
        "n_contacts": -1 if contacts is None else len(contacts.contacts),
        "n_contacts_found": -1 if contacts is None else contacts.n_found, **contact_columns(first),
        **softness_columns(None if contacts is None else contacts.softness),
        "covariance": np.full((6, 6), np.nan) if covariance is None else covariance,
        "covariance_validity": 0 if wrench is None else wrench.covariance_validity,
        "depth_sigma_m": np.nan if frame.depth is None or frame.depth.sigma is None else frame.depth.sigma,
        **learned_columns(frame.learned),
        "flag_bits": frame.flag_bits, "flags": " ".join(frame.flags), "is_stale": frame.is_stale,
        "is_simulated": frame.is_simulated, "is_replay": frame.is_replay,
        "n_missed": -1 if frame.n_missed is None else frame.n_missed,
    }  # fmt: skip


def _valid_sigma(field: Field) -> Any:
    return None if field.sigma is None else valid_or_nan(field.sigma, (field.sigma_validity,) * 3, field.flags)


def _dense(frames: list[SensorFrame], get: Callable[[SensorFrame], Any], shape: tuple[int, ...]) -> npt.NDArray[Any]:
    """NaN in frames that have none, or one of another size."""
    out = np.full((len(frames), *shape), np.nan, np.float32)
    for row, frame in zip(out, frames, strict=True):
        if (values := get(frame)) is not None and values.shape == shape:
            row[:] = values
    return out


def _flat(block: Block) -> Block:
    """Columns of one number each; fields are left out."""
    out: Block = {}
    for name, values in block.items():
        if name in CELLS:
            out.update(zip(CELLS[name], values.T, strict=True))
        elif values.ndim == 1 and name != "has_field":
            out[name] = values
    return out


def _csv(path: Path, blocks: Iterator[Block], _: dict[str, Any]) -> None:
    with path.open("w", newline="") as stream:
        writer = None
        for block in map(_flat, blocks):
            if writer is None:
                writer = csv.writer(stream)
                writer.writerow(block)
            for row in zip(*(values.tolist() for values in block.values()), strict=True):
                writer.writerow(map(_cell, block, row))


def _cell(name: str, value: Any) -> Any:
    if value != value or (name in UNKNOWN and value == -1):
        return ""
    return int(value) if isinstance(value, bool) else value


def _npz(path: Path, blocks: Iterator[Block], about: dict[str, Any]) -> None:
    kept = list(blocks)
    with path.open("wb") as stream:
        arrays: dict[str, Any] = {name: np.concatenate([b[name] for b in kept]) for name in kept[0]}
        np.savez_compressed(stream, **about, **arrays)


def _hdf5(path: Path, blocks: Iterator[Block], about: dict[str, Any]) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        file["node_place_m"] = about.pop("node_place_m")
        about["flag_names"] = [str(name) for name in about["flag_names"]]
        for name, value in about.items():
            file.attrs[name] = value
        at = 0
        for block in blocks:
            n = len(block["frame"])
            for name, values in block.items():
                is_text = values.dtype.kind == "U"
                if name not in file:
                    kind = h5py.string_dtype() if is_text else values.dtype
                    file.create_dataset(name, (0, *values.shape[1:]), kind, maxshape=(None, *values.shape[1:]),
                                        chunks=(min(BLOCK, 32 if values.ndim > 2 else BLOCK), *values.shape[1:]),
                                        compression="gzip", shuffle=not is_text)  # fmt: skip
                file[name].resize(at + n, axis=0)
                file[name][at:] = values.astype(object) if is_text else values
            at += n


def _parquet(path: Path, blocks: Iterator[Block], about: dict[str, Any]) -> None:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise missing("Parquet", "parquet", ", or choose another --format") from error
    writer = None
    try:
        for block in map(_flat, blocks):
            table = pyarrow.table(block)
            if writer is None:
                told = {k: str(v) for k, v in about.items() if isinstance(v, str)}
                writer = pyarrow.parquet.ParquetWriter(path, table.schema.with_metadata(told))
            writer.write_table(table.cast(writer.schema))
    finally:
        if writer is not None:
            writer.close()
