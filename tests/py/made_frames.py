"""Frames of a made-up sensor, for tests of what becomes of them elsewhere."""

from __future__ import annotations

from typing import Any

import numpy as np

from ruffini.api.frame import SensorFrame
from ruffini.device import Learned
from ruffini.wire import Schema
from ruffini.wire.dense import encode_dense

SCHEMA = Schema.own()
N_X, N_Y = 3, 2
NODES = np.stack(np.meshgrid([-1e-3, 0, 1e-3], [0, 2e-3]), axis=-1)
FORCE = np.arange(18).reshape(N_Y, N_X, 3) - 9  # steps of 10 uN


def dense(values: np.ndarray) -> Any:
    codec, data = encode_dense(values, values.shape[-1])
    return SCHEMA.new("Dense", codec=codec, n_x=values.shape[1], n_y=values.shape[0], n_components=values.shape[2],
                      data=data)  # fmt: skip


def parts(validity: int) -> dict[str, Any]:
    """What each stage adds to a contact; no board has them all."""
    return {
        "skin": {"place_um": [1, 2, 3], "normal_force_un": [4, 5, 6], "force_sigma_un": 7, "center_sigma_um": 8},
        "tool": {"tool_um": [11, 12, 13], "turn_urad": [14, 15], "normal_force_un": [16, 17, 18],
                 "tool_sigma": [21, 22, 23, 24, 25, 26, 27], "flat_area_um2_k": 28, "flat_area_sigma_um2_k": 29},
        "model": {"depth_validity": validity, "kind": 2, "kind_sure_1e3": 870, "gel_depth_um": 31, "press_depth_um": 32,
                  "depth_sigma_um": 33, "effective_area_um2_k": 34, "stiffness_pa_um": -35, "shore_a_1e1": 360,
                  "shore_a_sigma_1e1": 37, "hardness_validity": validity, "mean_flow_um": 38,
                  "moment_by_flow_unmm": 39},
        "helmholtz": {"curl_free_nm": 41, "divergence_free_nm": 42, "twist_urad": -43},
    }  # fmt: skip


def frame(*, validity: tuple[int, ...] = (1,) * 6, flags: int = 0, is_simulated: bool = True) -> SensorFrame:
    """A press of (1, -2, -3) mN with moments of (4, 5, 6) uN m, its covariance, field, depth and a contact."""
    stamp = {"capture_us": 7_000_000, "frame": 420, "flags": flags}
    upper = [4, 0, 0, 0, 0, 8, 4, 0, 0, 0, 0, 49, -98, 0, 0, 260, 0, 0, 64, 0, 25]
    wrench = SCHEMA.new(
        "Wrench", stamp=stamp, force_x_un=1000, force_y_un=-2000, force_z_un=-3000, torque_x_un_um=4_000_000,
        torque_y_un_um=5_000_000, torque_z_un_um=6_000_000, validity=validity, covariance=upper,
        covariance_validity=1,
    )  # fmt: skip
    slip = dense(np.full((N_Y, N_X, 1), 2))
    field = SCHEMA.new("Field", stamp=stamp, force_lsb_un=10, force=dense(FORCE), displacement_lsb_nm=100,
                       displacement=dense(FORCE), validity=validity[:3], slip=slip)  # fmt: skip
    depth = SCHEMA.new("Depth", stamp=stamp, depth_lsb_nm=1000, step_px=2, validity=validity[2],
                       depth=dense(-np.arange(12).reshape(3, 4, 1)))  # fmt: skip
    contact = {"id": 3, "area_um2_k": 5000, "center_x_um": 100, "center_y_um": -200, "force_z_un": -3000,
               "peak_depth_nm": -50_000, "validity": validity[2], "reaches_border": True,
               "slip": {"slip_state": 2, "shear_ratio_1e3": 350}, **parts(validity[2])}  # fmt: skip
    softness = {"validity": validity[2], "squeeze": 2, "n_frames": 12, "modulus_pa": 60_000, "low_pa": 40_000,
                "log_share_q16": -32_768, "log_sigma_q16": 8192}  # fmt: skip
    contacts = SCHEMA.new("Contacts", stamp=stamp, contacts=[contact], n_found=9, softness=softness)
    residual = SCHEMA.new("Residual", stamp=stamp, residual_lsb_1e6=15_625, residual=dense(FORCE), validity=validity[2])
    messages = {"WRENCH": wrench, "FIELD": field, "DEPTH": depth, "CONTACTS": contacts, "RESIDUAL": residual}
    learned = Learned(6.5, 419, flags, {"force_un": 4, "roll_urad": -5}, True, 0.01, 0.02, 30.0)
    return SensorFrame("00-1", 0, 420, 7.0, 5_000_000_000, 20_000, flags, ("FLAG_LIGHT",) if flags else (),
                       is_simulated, False, messages, learned)  # fmt: skip
