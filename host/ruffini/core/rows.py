"""Rows of integers that the core says of a frame, as firmware/capi/ruffini_core.h has them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt


class ContactRow(NamedTuple):
    """One contact of the last frame: integers as in proto/ruffini.proto; `slip_state` its SlipState."""

    n_nodes: int
    area_um2: int
    center_x_um: int
    center_y_um: int
    force_x_un: int
    force_y_un: int
    force_z_un: int
    peak_depth_nm: int
    slip_state: int
    shear_ratio_1e3: int
    friction_1e3: int
    friction_sigma_1e3: int
    slip_share_1e3: int
    slip_margin_un: int
    reaches_border: int


class TouchRow(NamedTuple):
    """One touch of a glowing skin in the last frame; the skin is unrolled, the force also a vector along its normal."""

    id: int
    x_um: int
    y_um: int
    area_um2: int
    brightness: int
    press_un: int
    press_sigma_un: int
    place_sigma_um: int
    force_x_un: int
    force_y_un: int
    force_z_un: int


class SkinState(NamedTuple):
    """Number of taxels, their light over that at rest less 1, and the light at rest over the calibration's."""

    n_taxels: int
    light: float
    age: float


class TipRow(NamedTuple):
    """What presses on a fingertip in the last frame: a tool that came down along its own axis; micro-units.

    x, y : offset of its axis from the fingertip's, in its own axes; roll, pitch : of the fingertip under it; area : of
    its face; flat : area of the wall that lies in its plane.
    sigma_* : standard deviations, one for both places and one for both angles.
    """

    is_touched: int
    is_known: int
    is_in_range: int
    force_un: int
    way_um: int
    x_um: int
    y_um: int
    roll_urad: int
    pitch_urad: int
    area_um2: int
    sigma_force_un: int
    sigma_way_um: int
    sigma_x_um: int
    sigma_y_um: int
    sigma_roll_urad: int
    sigma_pitch_urad: int
    sigma_area_um2: int
    flat_um2: int
    sigma_flat_um2: int


class ProfileRow(NamedTuple):
    """What the stage contact_model sees in the flow (firmware/stages/contact_model/contact_profile.h): integers."""

    radial_q4: npt.NDArray[np.int64]
    size_q4: int
    fall_q16: int
    center_x_um: int
    center_y_um: int
    lost_1e3: int
    flow_q4: int


class HelmholtzRow(NamedTuple):
    """Sums of the parts of the flow (firmware/stages/helmholtz/helmholtz.h): integers."""

    curl_free_q4: int
    divergence_free_q4: int
    twist_urad: int


class ModelledRow(NamedTuple):
    """What the stage contact_model says of the last frame (firmware/stages/contact_model/contact_model.h): integers."""

    is_touched: int
    kind: int
    sure_1e3: int
    gel_depth_um: int
    press_depth_um: int
    depth_sigma_um: int
    area_um2: int
    effective_area_um2: int
    stiffness_pa_um: int
    shore_q4: int
    shore_sigma_q4: int
    is_strange: int
    depth_validity: int
    hardness_validity: int
    mean_flow_um: int
    moment_by_flow_unmm: int
