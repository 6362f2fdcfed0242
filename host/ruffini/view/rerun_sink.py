"""Frames of a sensor into Rerun: `ruffini rerun`, extra [rerun].

Everything stands below the sensor's name, `simulated_` before it where the camera is simulated, `replay_` where it is a
recording. SI units, pad frame (x right and y down in the camera's image, z out of the pad, which is Rerun's RDF).
Where forces are not valid no arrow is drawn, the curves have a gap (NaN), and `flags` says why.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.api.frame import SensorFrame
from ruffini.device.results import VALID, Contacts, Field, Learned, Markers, valid_or_nan
from ruffini.device.system_clock import SystemClock
from ruffini.record.columns import contact_columns, softness_columns

Array = npt.NDArray[np.float64]
CURVES = {"force_n": "force", "torque_nm": "torque"}
AXIS_COLOURS = [(213, 94, 0), (0, 158, 115), (0, 114, 178)]  # told apart by colour-blind people, too
WRENCH_M_PER_N = 0.01
NODE_AXES = ("y", "x", "component")
FULL_DEPTH_M = 0.5e-3  # pressed in so far a node is darkest


def grid_triangles(n_x: int, n_y: int) -> npt.NDArray[np.uint32]:
    """(n, 3) corners of the triangles between n_x x n_y nodes, x fastest."""
    corner = (np.arange(n_y - 1)[:, None] * n_x + np.arange(n_x - 1)).ravel()
    lower = np.stack([corner, corner + 1, corner + n_x], axis=1)
    upper = np.stack([corner + 1, corner + n_x + 1, corner + n_x], axis=1)
    return np.concatenate([lower, upper]).astype(np.uint32)


def _or_nan(value: float | None) -> float:
    return float("nan") if value is None else value


class RerunSink:
    """Writes frames to a recording stream.

    Parameters
    ----------
    rr : the module `rerun`, or what stands for it.
    stream : an open RecordingStream.
    nodes : by sensor (n_y, n_x, 2) metres, places of the field's nodes.
    """

    def __init__(self, rr: Any, stream: Any, name: str, nodes: dict[int, Array], *, arrow_m_per_n: float) -> None:
        self._rr, self._stream, self._name, self._nodes = rr, stream, name, nodes
        self._arrow_m_per_n = arrow_m_per_n
        self._clock = SystemClock()
        self._told: dict[str, tuple[str, ...]] = {}

    def put(self, frame: SensorFrame) -> None:
        """One picture's results."""
        mark = "simulated_" if frame.is_simulated else "replay_" if frame.is_replay else ""
        sensor = frame.sensor if frame.sensor in self._nodes else 0  # 255: the first one's result again
        pad = f"{mark}{self._name}/pad{sensor}"
        self._stream.set_time("camera frame", sequence=frame.number)
        if frame.host_time_ns is not None:
            self._stream.set_time("captured", timestamp=1e-9 * self._clock.from_monotonic(frame.host_time_ns))
        if pad not in self._told:
            self._begin(pad, mark)
        self._flags(pad, frame)
        self._wrench(pad, frame)
        if frame.field is not None and sensor in self._nodes:
            self._field(pad, frame.field, self._nodes[sensor])
        if frame.depth is not None:
            self._stream.log(f"{pad}/pressed_in", self._rr.DepthImage(-frame.depth.depth.astype(np.float32), meter=1.0))
            self._stream.log(f"{pad}/depth_sigma_m", self._rr.Scalars(_or_nan(frame.depth.sigma)))
        if frame.residual is not None:
            self._stream.log(f"{pad}/residual", self._rr.Tensor(frame.residual.residual, dim_names=NODE_AXES))
        if frame.markers is not None:
            self._markers(pad, frame.markers)
        if frame.contacts is not None:
            self._contacts(pad, frame.contacts)
        if frame.learned is not None:
            self._learned(pad, frame.learned)
        if frame.image is not None:
            self._stream.log(f"{pad}/camera", self._rr.Image(frame.image.pixels, "BGR"))

    def _begin(self, pad: str, mark: str) -> None:
        rr, log = self._rr, self._stream.log
        log(pad, rr.ViewCoordinates.RDF, static=True)
        for curve in CURVES:
            names = [f"{curve} {axis}" for axis in "xyz"]
            log(f"{pad}/{curve}", rr.SeriesLines(colors=AXIS_COLOURS, names=names), static=True)
        if mark:
            log(f"{pad}/flags", rr.TextLog(f"{mark.rstrip('_').upper()}: no force here was measured", level="WARN"))
        self._told[pad] = ()

    def _flags(self, pad: str, frame: SensorFrame) -> None:
        """Say what is wrong when that changes."""
        said = frame.flags if frame.is_valid else ("forces are not valid", *frame.flags)
        if said != self._told[pad]:
            self._told[pad] = said
            level = "INFO" if frame.is_valid else "WARN"
            self._stream.log(f"{pad}/flags", self._rr.TextLog(", ".join(said) or "forces are valid", level=level))

    def _wrench(self, pad: str, frame: SensorFrame) -> None:
        if frame.wrench is None:
            return
        for curve, part in CURVES.items():
            self._stream.log(f"{pad}/{curve}", self._rr.Scalars(getattr(frame.wrench, part)))
        is_stated = frame.wrench.covariance_validity == VALID and frame.wrench.sigma is not None
        sigma = frame.wrench.sigma if is_stated and frame.wrench.sigma is not None else np.full(6, np.nan)
        self._stream.log(f"{pad}/force_sigma_n", self._rr.Scalars(sigma[:3]))
        self._stream.log(f"{pad}/torque_sigma_nm", self._rr.Scalars(sigma[3:]))
        if is_stated:
            self._stream.log(f"{pad}/covariance", self._rr.Tensor(frame.wrench.covariance, dim_names=("row", "column")))
        force = frame.wrench.force
        arrows = [WRENCH_M_PER_N * force] if np.isfinite(force).all() else []
        self._stream.log(f"{pad}/total", self._rr.Arrows3D(vectors=arrows, colors=[(0, 0, 0)] * len(arrows)))

    def _contacts(self, pad: str, contacts: Contacts) -> None:
        """Every number of every contact as a curve of its own, largest contact first; words where they change."""
        log = self._stream.log
        log(f"{pad}/contacts/n_found", self._rr.Scalars(float(contacts.n_found)))
        if contacts.softness is not None:
            for name, value in softness_columns(contacts.softness).items():
                log(f"{pad}/{name.replace('_', '/', 1)}", self._rr.Scalars(float(value)))
        for rank, contact in enumerate(contacts.contacts):
            for name, value in contact_columns(contact, has_absent=False).items():
                path = f"{pad}/contacts/{rank}/{name.removeprefix('contact_')}"
                if not isinstance(value, str):
                    log(path, self._rr.Scalars(float(value)))
                elif self._told.get(path) != (value,):
                    self._told[path] = (value,)
                    log(path, self._rr.TextLog(value or "not measured"))

    def _learned(self, pad: str, learned: Learned) -> None:
        """The word on a frame, once; NaN where it is not valid."""
        log, path = self._stream.log, f"{pad}/learned"
        if self._told.get(path) == (str(learned.frame),):
            return
        self._told[path] = (str(learned.frame),)
        for name, value in learned.quantities.items():
            log(f"{path}/{name}", self._rr.Scalars(float(value) if learned.is_valid else float("nan")))
        for name in ("took_s", "latency_s", "rate_hz"):
            log(f"{path}/{name}", self._rr.Scalars(getattr(learned, name)))
        log(f"{path}/is_valid", self._rr.Scalars(float(learned.is_valid)))
        log(f"{path}/frame", self._rr.Scalars(float(learned.frame)))

    def _markers(self, pad: str, markers: Markers) -> None:
        """Arrays as they are, absent ones left out."""
        arrays: dict[str, Any] = {
            "displacement_px": markers.displacement_px, "is_lost": markers.is_lost.astype(np.uint8),
            "rest_px": markers.rest_px, "quality": markers.quality, "area_px2": markers.area_px2,
        }  # fmt: skip
        for name, values in arrays.items():
            if values is not None:
                dims = NODE_AXES[: values.ndim]
                self._stream.log(f"{pad}/markers/{name}", self._rr.Tensor(values, dim_names=dims))

    def _field(self, pad: str, field: Field, nodes: Array) -> None:
        rr = self._rr
        n_y, n_x = nodes.shape[:2]
        places = np.concatenate([nodes, np.zeros((n_y, n_x, 1))], axis=2)
        if field.displacement is not None:
            moved = valid_or_nan(field.displacement, field.validity, field.flags)
            places = places + np.nan_to_num(moved)  # an axis that is not valid is drawn at rest, without an arrow
        depth = np.clip(-places[..., 2] / FULL_DEPTH_M, 0, 1)
        grey = np.round(230 - 150 * depth).astype(np.uint8).ravel()
        surface = rr.Mesh3D(vertex_positions=places.reshape(-1, 3), triangle_indices=grid_triangles(n_x, n_y),
                            vertex_colors=np.repeat(grey[:, None], 3, axis=1))  # fmt: skip
        self._stream.log(f"{pad}/surface", surface)
        force = field.force.reshape(-1, 3)
        shown = np.isfinite(force).all(axis=1) & (force != 0).any(axis=1)
        arrows = rr.Arrows3D(vectors=self._arrow_m_per_n * force[shown], origins=places.reshape(-1, 3)[shown],
                             colors=[AXIS_COLOURS[0]] * int(shown.sum()))  # fmt: skip
        self._stream.log(f"{pad}/force", arrows)
        sigma = None if field.sigma is None else valid_or_nan(field.sigma, (field.sigma_validity,) * 3, field.flags)
        for name, values in (("node_sigma_n", sigma), ("node_slip", field.slip)):
            if values is not None:
                self._stream.log(f"{pad}/{name}", rr.Tensor(values, dim_names=NODE_AXES[: values.ndim]))
