"""Results of the stream in SI units.

`force`, `torque` and `depth` are NaN wherever they must not be used: not measured, not calibrated, known to be wrong,
or marked with a flag that this host does not know. The numbers as sent are in `values`, `raw_force` and `raw_depth`,
with their validity.

Every `from_message` raises InputError if the parts of a message contradict each other, which no ruffini device sends.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError
from ruffini.wire.contact_parts import contact_part, number_of
from ruffini.wire.covariance import COVARIANCE_SIZE, full_covariance
from ruffini.wire.dense import decode_dense

Array = npt.NDArray[np.float64]
NETWORK_STATES = {0: "loading", 1: "runs", 2: "failed"}
NOT_MEASURED, VALID, UNCALIBRATED, INVALID = range(4)
KNOWN_FLAGS = (1 << 19) - 1  # of FlagBit: a number that carries an unknown flag is treated as invalid
SLIP_STATES = {1: "sticks", 2: "incipient", 3: "slides"}
AREA_STEPS = 256  # of a target's area in a square pixel
CONTACT_KINDS = {1: "planar", 2: "hertzian"}
Vector = tuple[float, float, float]


def _dense(message: Any) -> npt.NDArray[np.int32]:
    return decode_dense(message.codec, message.n_x, message.n_y, message.n_components, message.data)


def _fits(holds: bool, what: str) -> None:
    if not holds:
        raise InputError(f"{what} is inconsistent: update the host tools, or check which device is on this line")


def valid_or_nan(values: npt.ArrayLike, validity: Sequence[int], flags: int) -> Array:
    """`values` (..., n) where VALID, NaN elsewhere. `validity` has n entries; if it is empty, all values become NaN."""
    is_valid = np.array([v == VALID for v in validity] or False) & (flags & ~KNOWN_FLAGS == 0)
    return np.where(is_valid, np.asarray(values, np.float64), np.nan)


def _has(message: Any, part: str) -> bool:
    """True if the message carries this part; older schemas may lack the field."""
    return part in message.DESCRIPTOR.fields_by_name and message.HasField(part)


def _three(validity: Sequence[int]) -> tuple[int, ...]:
    _fits(len(validity) in (0, 3), f"a contact's force with {len(validity)} validities")
    return tuple(validity)


@dataclass(frozen=True)
class Wrench:
    """Force (N) and moment (N m) acting ON the pad, about the centre of the undeformed pad, in the pad frame.

    `values` (6,) are as sent, NaN where not measured: check `validity` before use. `force` and `torque` are safe.
    """

    capture_s: float
    frame: int
    flags: int
    values: Array
    validity: tuple[int, ...]
    covariance: Array | None = None  # (6, 6), N and N m
    covariance_validity: int = NOT_MEASURED

    @property
    def force(self) -> Array:
        """(3,) newtons; NaN where not VALID."""
        return valid_or_nan(self.values[:3], self.validity[:3], self.flags)

    @property
    def torque(self) -> Array:
        """(3,) N m; NaN where not VALID."""
        return valid_or_nan(self.values[3:], self.validity[3:], self.flags)

    @property
    def sigma(self) -> Array | None:
        """(6,) standard deviations, N and N m; None if not measured."""
        return None if self.covariance is None else np.sqrt(np.diag(self.covariance))

    @classmethod
    def from_message(cls, m: Any) -> Wrench:
        raw = np.array(
            [m.force_x_un, m.force_y_un, m.force_z_un, m.torque_x_un_um, m.torque_y_un_um, m.torque_z_un_um],
            float,
        )
        values = raw * np.array([1e-6] * 3 + [1e-12] * 3)
        validity = tuple(m.validity) or (NOT_MEASURED,) * 6
        _fits(len(validity) == 6, f"a WRENCH with {len(validity)} validities")
        values[np.array(validity) == NOT_MEASURED] = np.nan
        stated = getattr(m, "covariance_validity", NOT_MEASURED)  # older schemas have none
        covariance = (
            full_covariance(np.array(m.covariance)) if stated and len(m.covariance) == COVARIANCE_SIZE else None
        )
        return cls(
            m.stamp.capture_us * 1e-6, m.stamp.frame, m.stamp.flags, values, validity, covariance,
            NOT_MEASURED if covariance is None else stated,
        )  # fmt: skip


@dataclass(frozen=True)
class Field:
    """Nodal force (n_y, n_x, 3) in newtons and displacement in metres at the observed nodes, in the pad frame.

    `raw_force` is as sent: check `validity` before use. `force` is safe.
    """

    capture_s: float
    frame: int
    flags: int
    raw_force: Array
    force_steps: npt.NDArray[np.int32]
    force_lsb_n: float
    displacement: Array | None
    validity: tuple[int, ...]
    slip: npt.NDArray[np.int32] | None = None  # (n_y, n_x) NodeSlip: 0 no contact, 1 sticks, 2 slips
    sigma: Array | None = None  # (n_y, n_x, 3) standard deviation of `force`, N
    sigma_validity: int = NOT_MEASURED

    @classmethod
    def from_message(cls, m: Any) -> Field:
        steps = _dense(m.force)
        lsb = m.force_lsb_un * 1e-6
        displacement = _dense(m.displacement) * (m.displacement_lsb_nm * 1e-9) if m.HasField("displacement") else None
        slip, sigma = (_dense(getattr(m, part)) if _has(m, part) else None for part in ("slip", "sigma"))
        parts = [part.shape for part in (displacement, sigma) if part is not None]
        _fits(steps.shape[2] == 3 and all(shape == steps.shape for shape in parts), "a FIELD of several sizes")
        _fits(slip is None or slip.shape == (*steps.shape[:2], 1), "a FIELD and its slip")
        return cls(
            m.stamp.capture_us * 1e-6, m.stamp.frame, m.stamp.flags, steps * lsb, steps, lsb, displacement,
            tuple(m.validity), None if slip is None else slip[..., 0], None if sigma is None else sigma * lsb,
            NOT_MEASURED if sigma is None else m.sigma_validity,
        )  # fmt: skip

    @cached_property
    def force(self) -> Array:
        """(n_y, n_x, 3) newtons acting ON the pad; NaN in each component that is not VALID."""
        return valid_or_nan(self.raw_force, self.validity, self.flags)

    def slip_margin(self, friction: float) -> Array:
        """Shear that each node can still bear before it slips, friction |f_z| - |f_t|, (n_y, n_x) newtons.

        0 at nodes without contact; NaN everywhere unless all three components are VALID.
        """
        pressure = np.clip(-self.force[..., 2], 0, None)
        margin = friction * pressure - np.hypot(self.force[..., 0], self.force[..., 1])
        return np.where(pressure == 0, margin * 0, margin)


@dataclass(frozen=True)
class FlowParts:
    """Helmholtz decomposition of the optical flow of a texture.

    curl_free : mean magnitude of the gradient part, m. divergence_free : magnitude of the mean of the remainder, m.
    twist : rotation of the object about z, from x towards y, rad, if the contact sticks and is wide.
    """

    curl_free: float
    divergence_free: float
    twist: float


def _vector(values: Sequence[int], n: int, unit: float, what: str) -> tuple[float, ...]:
    _fits(len(values) == n, f"{what} of {len(values)} numbers")
    return tuple(v * unit for v in values)


def _or_none(value: int, unit: float) -> float | None:
    """None for 0, which means "not stated" on the wire."""
    return value * unit or None


def _erased(part: Any) -> Any:
    """A copy with every number replaced by NaN."""
    return type(part)(**{f.name: _nan_like(getattr(part, f.name)) for f in fields(part)})


def _nan_like(value: Any) -> Any:
    return (float("nan"),) * len(value) if isinstance(value, tuple) else value if value is None else float("nan")


@dataclass(frozen=True)
class SkinTouch:
    """A touch on a curved skin, in the camera frame: centre on the undeformed skin and force along the local normal.

    The standard deviations of the force's magnitude and of the contact's `center` are None if not stated.
    """

    place_m: Vector
    normal_force_n: Vector
    force_sigma_n: float | None
    center_sigma_m: float | None

    @classmethod
    def from_contact(cls, m: Any) -> SkinTouch | None:
        if (part := contact_part(m, "skin")) is None:
            return None
        place: Any = _vector(part.place_um, 3, 1e-6, "a skin's place")
        force: Any = _vector(part.normal_force_un, 3, 1e-6, "a skin's force")
        return cls(place, force, _or_none(part.force_sigma_un, 1e-6), _or_none(part.center_sigma_um, 1e-6))


@dataclass(frozen=True)
class ToolTouch:
    """A tool pressed along its own axis into a round fingertip.

    place_m : offset of the tool's axis from the fingertip's, in the tool's axes. way_m : travel since first touch.
    roll_rad, pitch_rad : rotation of the fingertip under the tool, about x, then about y.
    normal_force_n : along the tool's axis, in the camera frame.
    flat_area_m2 : area of the wall that lies in the tool's plane, None if not measured. The area of the tool's face is
        the contact's `area`.
    """

    place_m: tuple[float, float]
    way_m: float
    roll_rad: float
    pitch_rad: float
    normal_force_n: Vector
    force_sigma_n: float
    place_sigma_m: tuple[float, float]
    way_sigma_m: float
    roll_sigma_rad: float
    pitch_sigma_rad: float
    face_area_sigma_m2: float
    flat_area_m2: float | None
    flat_area_sigma_m2: float | None

    @classmethod
    def from_contact(cls, m: Any) -> ToolTouch | None:
        if (part := contact_part(m, "tool")) is None:
            return None
        x, y, way = _vector(part.tool_um, 3, 1e-6, "a tool's place")
        roll, pitch = _vector(part.turn_urad, 2, 1e-6, "a tool's turn")
        force: Any = _vector(part.normal_force_un, 3, 1e-6, "a tool's force")
        sigma = _vector(part.tool_sigma, 7, 1e-6, "a tool's standard deviations")
        flat, flat_sigma = (number_of(part, name) for name in ("flat_area_um2_k", "flat_area_sigma_um2_k"))
        return cls((x, y), way, roll, pitch, force, sigma[0], (sigma[1], sigma[2]), sigma[3], sigma[4], sigma[5],
                   1e-3 * sigma[6], _or_none(flat, 1e-9), _or_none(flat_sigma, 1e-9) if flat else None)  # fmt: skip


@dataclass(frozen=True)
class ContactModel:
    """Estimates of the contact models from the flow of a texture; each number is NaN unless its validity is VALID.

    kind : "planar" or "hertzian", None before a press is detected; kind_confidence 0.5 to 1.
    gel_depth_m : indentation of the gel. press_depth_m : travel of the object since first touch, including the
        object's own deformation.
    stiffness_pa_per_m : of this press, d(normal force / effective area) / d(gel depth).
    moment_by_flow_nm : k S_t, the paper's estimate of the moment about z; the integrated moment is in the wrench.
    """

    kind: str | None
    kind_confidence: float | None
    gel_depth_m: float
    gel_depth_sigma_m: float
    press_depth_m: float
    effective_area_m2: float
    depth_validity: int
    stiffness_pa_per_m: float
    shore_a: float
    shore_a_sigma: float
    hardness_validity: int
    mean_flow_m: float
    moment_by_flow_nm: float

    @classmethod
    def from_contact(cls, m: Any, flags: int) -> ContactModel | None:
        if (part := contact_part(m, "model")) is None:
            return None
        kind = CONTACT_KINDS.get(part.kind)
        depth = float(valid_or_nan(1.0, (part.depth_validity,), flags)[0])  # 1, or NaN
        hardness = float(valid_or_nan(1.0, (part.hardness_validity,), flags)[0])
        return cls(
            kind, part.kind_sure_1e3 * 1e-3 if kind else None, depth * part.gel_depth_um * 1e-6,
            depth * part.depth_sigma_um * 1e-6, depth * part.press_depth_um * 1e-6,
            depth * part.effective_area_um2_k * 1e-9, part.depth_validity, hardness * part.stiffness_pa_um * 1e6,
            hardness * part.shore_a_1e1 * 0.1, hardness * part.shore_a_sigma_1e1 * 0.1, part.hardness_validity,
            part.mean_flow_um * 1e-6, part.moment_by_flow_unmm * 1e-9,
        )  # fmt: skip


@dataclass(frozen=True)
class Contact:
    """One contact, in newtons, metres and square metres; None where not measured.

    `slip_state` is "sticks", "incipient" or "slides"; `slip_share` is the slipping fraction of its area and
    `slip_margin_n` the shear it can still bear. `raw_force`, `raw_skin` and `raw_tool` are as sent: check the
    validities; `force`, `skin` and `tool` are safe. With `reaches_border` the contact may extend beyond the camera's
    window, and all numbers are of the visible part.
    """

    area: float
    center: tuple[float, float]
    raw_force: tuple[float, float, float]
    peak_depth: float
    validity: int
    slip_state: str | None
    shear_ratio: float | None
    slip_share: float | None
    friction: float | None
    friction_sigma: float | None
    slip_margin_n: float | None
    flow_parts: FlowParts | None
    id: int = 0  # constant for the life of the contact
    force_validity: tuple[int, ...] = ()  # x, y, z
    flags: int = 0
    reaches_border: bool = False
    raw_skin: SkinTouch | None = None
    raw_tool: ToolTouch | None = None
    model: ContactModel | None = None

    @property
    def force(self) -> Array:
        """(3,) newtons acting ON the pad; NaN where not VALID."""
        return valid_or_nan(self.raw_force, self._axes, self.flags)

    @property
    def skin(self) -> SkinTouch | None:
        """Touch on a skin; every number is NaN unless the normal force is VALID."""
        return self.raw_skin if self.raw_skin is None or self._is_normal_valid else _erased(self.raw_skin)

    @property
    def tool(self) -> ToolTouch | None:
        """Tool on a fingertip; every number is NaN unless the contact is VALID."""
        return self.raw_tool if self.raw_tool is None or self._is_normal_valid else _erased(self.raw_tool)

    @property
    def _axes(self) -> tuple[int, ...]:
        return self.force_validity or (self.validity,) * 3

    @property
    def _is_normal_valid(self) -> bool:
        return self._axes[2] == VALID and not self.flags & ~KNOWN_FLAGS

    @classmethod
    def from_message(cls, m: Any, flags: int = 0) -> Contact:
        slip: Any = None if flags & ~KNOWN_FLAGS else contact_part(m, "slip")
        state = None if slip is None else SLIP_STATES.get(slip.slip_state)
        has_slip = state is not None
        has_friction = has_slip and slip.friction_1e3 > 0
        parts = contact_part(m, "helmholtz")
        return cls(
            m.area_um2_k * 1e-9, (m.center_x_um * 1e-6, m.center_y_um * 1e-6),
            (m.force_x_un * 1e-6, m.force_y_un * 1e-6, m.force_z_un * 1e-6), m.peak_depth_nm * 1e-9, m.validity,
            state, slip.shear_ratio_1e3 * 1e-3 if has_slip else None, slip.slip_share_1e3 * 1e-3 if has_slip else None,
            slip.friction_1e3 * 1e-3 if has_friction else None,
            slip.friction_sigma_1e3 * 1e-3 if has_friction else None,
            slip.slip_margin_un * 1e-6 if has_friction else None,
            parts and FlowParts(parts.curl_free_nm * 1e-9, parts.divergence_free_nm * 1e-9, parts.twist_urad * 1e-6),
            m.id, _three(getattr(m, "force_validity", ())), flags, bool(number_of(m, "reaches_border")),
            SkinTouch.from_contact(m), ToolTouch.from_contact(m), ContactModel.from_contact(m, flags),
        )  # fmt: skip


@dataclass(frozen=True)
class Softness:
    """The last squeeze of an object, until the next one; of boards with the stage softness.

    squeeze : number of squeezes since rest was learned; it rises with each result.
    modulus_pa, low_pa, high_pa : E / (1 - nu^2) of an object of the radius of the rigid ones that were fitted, and one
        standard deviation below and above; infinite if it cannot be told from a rigid one. NaN if not VALID.
    log_share, log_sigma : log2 of the curvature of its dent over that of a rigid object, and its standard deviation, by
        which two objects of one shape compare. NaN if not VALID.
    """

    squeeze: int
    n_frames: int
    modulus_pa: float
    low_pa: float
    high_pa: float
    log_share: float
    log_sigma: float
    validity: int

    @classmethod
    def from_message(cls, m: Any) -> Softness | None:
        if "softness" not in m.DESCRIPTOR.fields_by_name or not m.HasField("softness"):  # older schemas have none
            return None
        part = m.softness
        numbers = [part.modulus_pa or np.inf, part.low_pa, part.high_pa or np.inf, part.log_share_q16 / 65536,
                   part.log_sigma_q16 / 65536]  # fmt: skip
        modulus, low, high, share, sigma = valid_or_nan(numbers, (part.validity,) * 5, m.stamp.flags).tolist()
        return cls(part.squeeze, part.n_frames, modulus, low, high, share, sigma, part.validity)


@dataclass(frozen=True)
class Contacts:
    """The separate contacts, largest first; `n_found` also counts contacts that did not fit into the message.

    softness : of the last squeezed object, None if the board has no such stage.
    """

    capture_s: float
    frame: int
    flags: int
    contacts: tuple[Contact, ...]
    n_found: int
    softness: Softness | None = None

    @classmethod
    def from_message(cls, m: Any) -> Contacts:
        contacts = tuple(Contact.from_message(c, m.stamp.flags) for c in m.contacts)
        return cls(m.stamp.capture_us * 1e-6, m.stamp.frame, m.stamp.flags, contacts, m.n_found,
                   Softness.from_message(m))  # fmt: skip


@dataclass(frozen=True)
class Depth:
    """Surface displacement u_z along the pixels' rays on the depth grid, (n_y, n_x), metres.

    `raw_depth` is as sent: check `validity` before use. `depth` is safe. `sigma` is the standard deviation under
    contact, metres, None if the sensor does not state it. `step_px` is the pitch of the grid in pixels.
    """

    capture_s: float
    frame: int
    flags: int
    raw_depth: Array
    validity: int
    step_px: int
    sigma: float | None

    @cached_property
    def depth(self) -> Array:
        """(n_y, n_x) metres; NaN where not VALID."""
        return valid_or_nan(self.raw_depth[..., None], (self.validity,), self.flags)[..., 0]

    @classmethod
    def from_message(cls, m: Any) -> Depth:
        values = _dense(m.depth)
        _fits(values.shape[2] == 1, "a DEPTH of several components")
        depth = values[..., 0] * (m.depth_lsb_nm * 1e-9)
        return cls(m.stamp.capture_us * 1e-6, m.stamp.frame, m.stamp.flags, depth, m.validity, m.step_px,
                   getattr(m, "sigma_um", 0) * 1e-6 or None)  # fmt: skip


@dataclass(frozen=True)
class Residual:
    """Displacement at each node that the estimated forces do not explain, in standard deviations along x, y, z.

    About 1 if pad and noise are as calibrated, under any contact; see proto/README.md. `raw_residual` (n_y, n_x, 3) is
    as sent, empty if not measured: check `validity` before use. `residual` is safe.
    """

    capture_s: float
    frame: int
    flags: int
    raw_residual: Array
    validity: int

    @cached_property
    def residual(self) -> Array:
        """(n_y, n_x, 3) standard deviations; NaN where not VALID."""
        return valid_or_nan(self.raw_residual, (self.validity,) * 3, self.flags)

    @cached_property
    def size(self) -> Array:
        """(n_y, n_x), root mean square over x, y and z, as shown on the page's map."""
        return np.asarray(np.sqrt(np.mean(np.square(self.residual), axis=2)))

    @classmethod
    def from_message(cls, m: Any) -> Residual:
        values = _dense(m.residual) if m.HasField("residual") else np.zeros((0, 0, 3), np.int32)
        _fits(values.shape[2] == 3, f"a RESIDUAL of {values.shape[2]} components")
        return cls(
            m.stamp.capture_us * 1e-6, m.stamp.frame, m.stamp.flags, values * (m.residual_lsb_1e6 * 1e-6),
            m.validity if m.HasField("residual") else NOT_MEASURED,
        )  # fmt: skip


@dataclass(frozen=True)
class Markers:
    """Markers, patches or targets in the image, row by row, (n_y, n_x, 2) pixels: displacement from rest, and rest.

    `is_lost` marks values estimated from neighbours. `quality` is 255 / (1 + (expected error / 0.1 px)^2), 0 if lost.
    `area_px2` is the change of a target's area from rest. Parts that were not sent are None.
    """

    capture_s: float
    frame: int
    flags: int
    displacement_px: Array
    is_lost: npt.NDArray[np.bool_]
    rest_px: Array | None
    quality: npt.NDArray[np.int32] | None
    area_px2: Array | None

    @classmethod
    def from_message(cls, m: Any) -> Markers:
        pixel = m.position_lsb_upx * 1e-6
        shape = (m.n_y, m.n_x)
        parts = {name: _dense(getattr(m, name)) if _has(m, name) and getattr(m, name).n_x else None
                 for name in ("displacement", "rest", "quality", "area")}  # fmt: skip
        sizes = {"displacement": 2, "rest": 2, "quality": 1, "area": 1}
        _fits(all(v is None or v.shape == (*shape, sizes[k]) for k, v in parts.items()), "a MARKERS of several sizes")
        moved, rest, quality, area = parts.values()
        _fits(moved is not None or 0 in shape, "a MARKERS without displacement")
        moved = np.zeros((*shape, 2), np.int32) if moved is None else moved
        lost = np.unpackbits(np.frombuffer(m.lost, np.uint8), bitorder="little")
        n = m.n_x * m.n_y
        is_lost = np.zeros(n, bool)
        is_lost[: min(n, len(lost))] = lost[:n] != 0
        return cls(
            m.stamp.capture_us * 1e-6, m.stamp.frame, m.stamp.flags, moved * pixel, is_lost.reshape(shape),
            None if rest is None else rest * pixel, None if quality is None else quality[..., 0],
            None if area is None else area[..., 0] / AREA_STEPS,
        )  # fmt: skip


@dataclass(frozen=True)
class Features:
    """What the wrench of a frame is made of: integers (n,) as the board has them, for calibration."""

    capture_s: float
    frame: int
    flags: int
    value: npt.NDArray[np.int32]

    @classmethod
    def from_message(cls, m: Any) -> Features:
        value = _dense(m.value)
        _fits(value.shape[0] == 1 == value.shape[2], "a FEATURES that is no row")
        return cls(m.stamp.capture_us * 1e-6, m.stamp.frame, m.stamp.flags, value.ravel())


@dataclass(frozen=True)
class Image:
    """The camera's frame, (h, w, 3) uint8, B G R; only every step_px-th pixel if the whole frame exceeds a message."""

    capture_s: float
    frame: int
    flags: int
    pixels: npt.NDArray[np.uint8]
    step_px: int

    @classmethod
    def from_message(cls, m: Any) -> Image:
        _fits(len(m.data) == m.height_px * m.width_px * 3, f"an IMAGE of {len(m.data)} bytes")
        pixels = np.frombuffer(m.data, np.uint8).reshape(m.height_px, m.width_px, 3)
        return cls(m.stamp.capture_us * 1e-6, m.stamp.frame, m.stamp.flags, pixels, m.step_px)


@dataclass(frozen=True)
class Learned:
    """Output of a learned network for a frame; it arrives later than the frame's other results and not for each frame.

    quantities : value by name with its unit, as the network names them, e.g. `force_un`; empty if it gave no number.
    is_valid : finite, and within the network's training range. took_s : inference alone. latency_s : since
    mid-exposure. rate_hz : rate of results, 0 at the first.
    """

    capture_s: float
    frame: int
    flags: int
    quantities: dict[str, int]
    is_valid: bool
    took_s: float
    latency_s: float
    rate_hz: float

    @classmethod
    def from_message(cls, m: Any) -> Learned:
        rate_hz = 1e6 / m.period_us if m.period_us else 0.0
        return cls(m.stamp.capture_us * 1e-6, m.stamp.frame, m.stamp.flags, {q.name: q.value for q in m.quantities},
                   m.validity == VALID, m.took_us * 1e-6, m.latency_us * 1e-6, rate_hz)  # fmt: skip


@dataclass(frozen=True)
class NetworkState:
    """State of a board's learned network; times are those of the last result, rate_hz is 0 before the second.

    state : "loading", "runs" or "failed"; `problem` gives the reason for a failure.
    """

    state: str
    problem: str
    sha256: str
    results: int
    invalid: int
    skipped: int
    took_s: float
    latency_s: float
    rate_hz: float

    @classmethod
    def from_status(cls, m: Any) -> NetworkState | None:
        """From STATUS; None if the board uses no network or the firmware predates these fields."""
        fields = m.DESCRIPTOR.fields_by_name
        if "network" not in fields or "period_us" not in fields["network"].message_type.fields_by_name:
            return None
        if not m.HasField("network"):
            return None
        n = m.network
        rate_hz = 1e6 / n.period_us if n.period_us else 0.0
        return cls(NETWORK_STATES.get(n.state, "unknown"), n.problem, n.sha256.hex(), n.results, n.invalid, n.skipped,
                   n.took_us * 1e-6, n.latency_us * 1e-6, rate_hz)  # fmt: skip

    def text(self) -> str:
        """One line."""
        if self.state != "runs":
            return self.state + (f": {self.problem}" if self.problem else "")
        if not self.results:
            return f"runs, no result yet, {self.sha256[:12]}"
        counts = f"{self.results} results, {self.invalid} invalid, {self.skipped} frames skipped, {self.sha256[:12]}"
        times = f"{self.rate_hz:.1f} Hz, takes {1e3 * self.took_s:.0f} ms, {1e3 * self.latency_s:.0f} ms behind"
        return f"runs, {times}; {counts}"


RESULTS: dict[str, Any] = {"WRENCH": Wrench, "FIELD": Field, "DEPTH": Depth, "CONTACTS": Contacts, "IMAGE": Image,
                           "LEARNED": Learned, "RESIDUAL": Residual, "MARKERS": Markers,
                           "FEATURES": Features}  # fmt: skip
