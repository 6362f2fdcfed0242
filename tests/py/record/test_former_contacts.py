"""Recordings of a version whose Contact had the numbers of all stages, with all results: tests/data/recordings."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ruffini.device.results import Contact
from ruffini.record.recording import Recording
from ruffini.wire import Schema
from ruffini.wire.contact_parts import contact_part

FOLDER = Path(__file__).parents[2] / "data" / "recordings"
VALIDITIES = {None: 0, "VALIDITY_NOT_MEASURED": 0, "VALIDITY_VALID": 1, "VALIDITY_UNCALIBRATED": 2,
              "VALIDITY_INVALID": 3}  # fmt: skip
PARTS = {"nodes": set(), "skin": {"skin"}, "texture": {"model", "flow_parts"}, "fingertip": {"tool"}}


def told(name: str) -> list[tuple[dict[str, Any], Contact]]:
    """Each contact as the version that recorded it read it, and as it is read now."""
    before = json.loads((FOLDER / f"{name}.json").read_text())
    frames = list(Recording(FOLDER / f"{name}.mcap").frames(partial=True))
    assert len(frames) == len(before) >= 12
    out = []
    for row, frame in zip(before, frames, strict=True):
        assert frame.contacts is not None
        assert frame.wrench is not None
        sent = row["CONTACTS"].get("contacts", [])
        assert frame.contacts.n_found == row["CONTACTS"].get("n_found", 0)
        out += list(zip(sent, frame.contacts.contacts, strict=True))
        force = np.array([int(row["WRENCH"].get(f"force_{axis}_un", 0)) * 1e-6 for axis in "xyz"])
        measured = np.array(frame.wrench.validity[:3]) != 0
        np.testing.assert_allclose(frame.wrench.values[:3][measured], force[measured])
    assert out
    return out


def numbers(row: dict[str, Any], name: str, unit: float) -> list[float]:
    return [unit * int(v) for v in row[name]]


@pytest.mark.parametrize("name", PARTS)
def test_every_contact_has_what_all_contacts_have(name: str) -> None:
    for row, contact in told(name):
        assert contact.id == row.get("id", 0)
        assert contact.area == pytest.approx(row.get("area_um2_k", 0) * 1e-9)
        assert contact.center == pytest.approx([row.get(f"center_{axis}_um", 0) * 1e-6 for axis in "xy"])
        assert contact.raw_force == pytest.approx([int(row.get(f"force_{axis}_un", 0)) * 1e-6 for axis in "xyz"])
        assert contact.peak_depth == pytest.approx(row.get("peak_depth_nm", 0) * 1e-9)
        assert contact.validity == VALIDITIES[row.get("validity")]
        assert contact.reaches_border == row.get("reaches_border", False)
        present = {part for part in ("skin", "tool", "model", "flow_parts") if getattr(contact, part) is not None}
        assert present == PARTS[name]


def test_a_skins_touches() -> None:
    for row, contact in told("skin"):
        skin = contact.raw_skin
        assert skin is not None
        assert skin.place_m == pytest.approx(numbers(row, "place_um", 1e-6))
        assert skin.normal_force_n == pytest.approx(numbers(row, "normal_force_un", 1e-6))
        assert skin.force_sigma_n == pytest.approx(int(row["force_sigma_un"]) * 1e-6)
        assert skin.center_sigma_m == pytest.approx(row["center_sigma_um"] * 1e-6)
        assert contact.force_validity == tuple(VALIDITIES[v] for v in row["force_validity"])


def test_a_fingertips_tool() -> None:
    for row, contact in told("fingertip"):
        tool = contact.raw_tool
        assert tool is not None
        assert (*tool.place_m, tool.way_m) == pytest.approx(numbers(row, "tool_um", 1e-6))
        assert (tool.roll_rad, tool.pitch_rad) == pytest.approx(numbers(row, "turn_urad", 1e-6))
        assert tool.normal_force_n == pytest.approx(numbers(row, "normal_force_un", 1e-6))
        sigma = (tool.force_sigma_n, *tool.place_sigma_m, tool.way_sigma_m, tool.roll_sigma_rad, tool.pitch_sigma_rad)
        assert (*sigma, 1e3 * tool.face_area_sigma_m2) == pytest.approx(numbers(row, "tool_sigma", 1e-6))
        assert (tool.flat_area_m2 or 0) == pytest.approx(1e-9 * row.get("flat_area_um2_k", 0))
        if tool.flat_area_m2:
            assert tool.flat_area_sigma_m2 == pytest.approx(1e-9 * row["flat_area_sigma_um2_k"])


def test_a_contact_model_and_the_parts_of_a_flow() -> None:
    n_hard = 0
    for row, contact in told("texture"):
        model, parts = contact.model, contact.flow_parts
        assert model is not None
        assert parts is not None
        assert model.depth_validity == VALIDITIES[row["depth_validity"]]
        assert model.hardness_validity == VALIDITIES[row.get("hardness_validity")]
        assert (model.kind or "not_told") == row.get("kind", "CONTACT_KIND_NOT_TOLD").lower().removeprefix(
            "contact_kind_"
        )
        assert model.mean_flow_m == pytest.approx(1e-6 * row.get("mean_flow_um", 0))
        assert model.moment_by_flow_nm == pytest.approx(1e-9 * int(row.get("moment_by_flow_unmm", 0)))
        if model.depth_validity == 1:
            assert model.gel_depth_m == pytest.approx(1e-6 * row["gel_depth_um"])
            assert model.press_depth_m == pytest.approx(1e-6 * row["press_depth_um"])
            assert model.gel_depth_sigma_m == pytest.approx(1e-6 * row["depth_sigma_um"])
            assert model.effective_area_m2 == pytest.approx(1e-9 * row["effective_area_um2_k"])
        if model.hardness_validity == 1:
            n_hard += 1
            assert model.shore_a == pytest.approx(0.1 * row["shore_a_1e1"])
            assert model.shore_a_sigma == pytest.approx(0.1 * row["shore_a_sigma_1e1"])
            assert model.stiffness_pa_per_m == pytest.approx(1e6 * row["stiffness_pa_um"])
        flow = row["helmholtz"]
        assert parts.curl_free == pytest.approx(1e-9 * flow.get("curl_free_nm", 0))
        assert parts.divergence_free == pytest.approx(1e-9 * flow.get("divergence_free_nm", 0))
        assert parts.twist == pytest.approx(1e-6 * flow.get("twist_urad", 0))
    assert n_hard >= 3


def test_stick_and_slip_of_a_former_contact() -> None:
    schema = Recording(FOLDER / "nodes.mcap").schema
    sent = {"slip_state": 2, "shear_ratio_1e3": 350, "friction_1e3": 500, "friction_sigma_1e3": 100,
            "slip_share_1e3": 620, "slip_margin_un": 25_000}  # fmt: skip
    contact = Contact.from_message(schema.new("Contact", validity=1, **sent))
    slip = [contact.shear_ratio, contact.friction, contact.friction_sigma, contact.slip_share, contact.slip_margin_n]
    assert contact.slip_state == "incipient"
    assert slip == pytest.approx([0.35, 0.5, 0.1, 0.62, 0.025])
    unknown = Contact.from_message(schema.new("Contact", validity=1, shear_ratio_1e3=350))
    assert unknown.slip_state is unknown.shear_ratio is None


@pytest.mark.parametrize("part", ["slip", "skin", "tool", "model"])
def test_each_stages_fields_had_the_same_names_in_a_former_contact(part: str) -> None:
    """That is what the reader of former contacts rests on."""
    former = Recording(FOLDER / "nodes.mcap").schema.new("Contact")
    now = Schema.own().new("Contact").DESCRIPTOR.fields_by_name[part].message_type
    for name, field in now.fields_by_name.items():
        assert former.DESCRIPTOR.fields_by_name[name].type == field.type, name
    assert contact_part(former, part) is None
