"""Results of the stream in SI units.

`force`, `torque` and `depth` are NaN wherever they must not be used: not measured, not calibrated, known to be wrong,
or marked with something that this host does not know. What was sent all the same is in `values`, `raw_force` and
`raw_depth`, with its validity.

Every `from_message` raises InputError where the parts of a message do not fit each other: no device of ours sends that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError
from ruffini.wire.covariance import COVARIANCE_SIZE, full_covariance
from ruffini.wire.dense import decode_dense

Array = npt.NDArray[np.float64]
NETWORK_STATES = {0: "loading", 1: "runs", 2: "failed"}
NOT_MEASURED, VALID, UNCALIBRATED, INVALID = range(4)
KNOWN_FLAGS = (1 << 19) - 1  # of FlagBit: a number with another one is not believed
SLIP_STATES = {1: "sticks", 2: "incipient", 3: "slides"}


def _dense(message: Any) -> npt.NDArray[np.int32]:
    return decode_dense(message.codec, message.n_x, message.n_y, message.n_components, message.data)


def _fits(holds: bool, what: str) -> None:
    if not holds:
        raise InputError(f"{what} does not fit: update the host tools, or see what speaks on this line")


def believed(values: npt.ArrayLike, validity: Sequence[int], flags: int) -> Array:
    """`values` (..., n) where they are VALID, NaN elsewhere; n validities, none: all of them NaN."""
    is_valid = np.array([v == VALID for v in validity] or False) & (flags & ~KNOWN_FLAGS == 0)
    return np.where(is_valid, np.asarray(values, np.float64), np.nan)


def _has(message: Any, part: str) -> bool:
    """Does the message bring this part? Older schemas do not know it."""
    return part in message.DESCRIPTOR.fields_by_name and message.HasField(part)


def _three(validity: Sequence[int]) -> tuple[int, ...]:
    _fits(len(validity) in (0, 3), f"a contact's force with {len(validity)} validities")
    return tuple(validity)


@dataclass(frozen=True)
class Wrench:
    """Force (N) and moment (N m) ON the pad about the undeformed pad centre.

    `values` (6,) as sent, NaN where not measured: see `validity` before they are used. `force` and `torque` are safe.
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
        """(3,) newtons; NaN where it is not VALID."""
        return believed(self.values[:3], self.validity[:3], self.flags)

    @property
    def torque(self) -> Array:
        """(3,) N m; NaN where it is not VALID."""
        return believed(self.values[3:], self.validity[3:], self.flags)

    @property
    def sigma(self) -> Array | None:
        """(6,) standard deviations, N and N m; None where they are not measured."""
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
    """Nodal force (n_y, n_x, 3) in newtons and displacement in metres on the observed nodes.

    `raw_force` as sent: see `validity` before it is used. `force` is safe.
    """

    capture_s: float
    frame: int
    flags: int
    raw_force: Array
    force_steps: npt.NDArray[np.int32]
    force_lsb_n: float
    displacement: Array | None
    validity: tuple[int, ...]
    slip: npt.NDArray[np.int32] | None = None  # (n_y, n_x) NodeSlip: 0 nothing presses, 1 sticks, 2 slips
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
        """(n_y, n_x, 3) newtons ON the pad; NaN in each component that is not VALID."""
        return believed(self.raw_force, self.validity, self.flags)

    def slip_margin(self, friction: float) -> Array:
        """Shear that each node still takes, friction |f_z| - |f_t|, (n_y, n_x) newtons; 0 where nothing presses.

        NaN everywhere unless all three components are VALID.
        """
        pressure = np.clip(-self.force[..., 2], 0, None)
        margin = friction * pressure - np.hypot(self.force[..., 0], self.force[..., 1])
        return np.where(pressure == 0, margin * 0, margin)


@dataclass(frozen=True)
class FlowParts:
    """Parts of a texture's flow: mean size of its gradient part, size of the mean of the rest (m), twist (rad).

    The twist is how far the object has turned about z, from x towards y, if the pad sticks to it and it is wide.
    """

    curl_free: float
    divergence_free: float
    twist: float


@dataclass(frozen=True)
class Contact:
    """One contact: newtons, metres, square metres; None where it is not measured.

    `slip_state` is "sticks", "incipient" or "slides"; `slip_share` of its area slips; `slip_margin_n` is the shear
    that it still takes. `raw_force` as sent: see the validities; `force` is safe.
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
    id: int = 0  # the same while it lasts
    force_validity: tuple[int, ...] = ()  # x, y, z
    flags: int = 0

    @property
    def force(self) -> Array:
        """(3,) newtons ON the pad; NaN where it is not VALID."""
        return believed(self.raw_force, self.force_validity or (self.validity,) * 3, self.flags)

    @classmethod
    def from_message(cls, m: Any, flags: int = 0) -> Contact:
        state = None if flags & ~KNOWN_FLAGS else SLIP_STATES.get(getattr(m, "slip_state", 0))
        told = state is not None
        known = told and m.friction_1e3 > 0
        parts = m.helmholtz if _has(m, "helmholtz") else None
        return cls(
            m.area_um2_k * 1e-9, (m.center_x_um * 1e-6, m.center_y_um * 1e-6),
            (m.force_x_un * 1e-6, m.force_y_un * 1e-6, m.force_z_un * 1e-6), m.peak_depth_nm * 1e-9, m.validity,
            state, m.shear_ratio_1e3 * 1e-3 if told else None, m.slip_share_1e3 * 1e-3 if told else None,
            m.friction_1e3 * 1e-3 if known else None, m.friction_sigma_1e3 * 1e-3 if known else None,
            m.slip_margin_un * 1e-6 if known else None,
            parts and FlowParts(parts.curl_free_nm * 1e-9, parts.divergence_free_nm * 1e-9, parts.twist_urad * 1e-6),
            m.id, _three(getattr(m, "force_validity", ())), flags,
        )  # fmt: skip


@dataclass(frozen=True)
class Contacts:
    """The separate contacts, largest first."""

    capture_s: float
    frame: int
    flags: int
    contacts: tuple[Contact, ...]

    @classmethod
    def from_message(cls, m: Any) -> Contacts:
        contacts = tuple(Contact.from_message(c, m.stamp.flags) for c in m.contacts)
        return cls(m.stamp.capture_us * 1e-6, m.stamp.frame, m.stamp.flags, contacts)


@dataclass(frozen=True)
class Depth:
    """u_z along the pixels' rays on the depth grid, (n_y, n_x), metres.

    `raw_depth` as sent: see `validity` before it is used. `depth` is safe. `sigma` metres, standard deviation where
    something touches; None where the sensor does not state it. `step_px`: pixels from cell to cell.
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
        """(n_y, n_x) metres; NaN where it is not VALID."""
        return believed(self.raw_depth[..., None], (self.validity,), self.flags)[..., 0]

    @classmethod
    def from_message(cls, m: Any) -> Depth:
        values = _dense(m.depth)
        _fits(values.shape[2] == 1, "a DEPTH of several components")
        depth = values[..., 0] * (m.depth_lsb_nm * 1e-9)
        return cls(m.stamp.capture_us * 1e-6, m.stamp.frame, m.stamp.flags, depth, m.validity, m.step_px,
                   getattr(m, "sigma_um", 0) * 1e-6 or None)  # fmt: skip


@dataclass(frozen=True)
class Residual:
    """What the forces leave unexplained of the displacement at each node, in standard deviations along x, y, z.

    About 1 where pad and noise are as the calibration takes them, whatever presses; see proto/README.md, "What the
    forces do not explain". `raw_residual` (n_y, n_x, 3) as sent, of no node where it is not measured: see `validity`
    before it is used. `residual` is safe.
    """

    capture_s: float
    frame: int
    flags: int
    raw_residual: Array
    validity: int

    @cached_property
    def residual(self) -> Array:
        """(n_y, n_x, 3) standard deviations; NaN where it is not VALID."""
        return believed(self.raw_residual, (self.validity,) * 3, self.flags)

    @cached_property
    def size(self) -> Array:
        """(n_y, n_x), root of the mean square of x, y and z: what the page's map shows."""
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
class Image:
    """The camera's frame, (h, w, 3) uint8, B G R; every step_px-th pixel of it where it does not fit a message."""

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
    """What a learned network says of a frame, later than the frame's other results and not of every frame.

    quantities : by name with its unit, as the network names them, e.g. `force_un`; none where it gave no number.
    is_valid : finite, and within what the network was taught; took_s of the network alone, latency_s from mid-exposure,
    rate_hz of results, 0 at the first.
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
    """How a board's learned network fares; times of the last result, rate_hz 0 before the second.

    state : loading, runs or failed; then `problem` says why.
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
        """Of STATUS; None where the board asks for no network, or the firmware is older than those fields."""
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
                           "LEARNED": Learned, "RESIDUAL": Residual}  # fmt: skip
