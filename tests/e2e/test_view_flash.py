"""A calibration flashed from the page onto the real daemon: in force, or refused with the reason of the sensor."""

from __future__ import annotations

import hashlib
from pathlib import Path

from browser import sensor_of, viewer, wait_for
from nacl.signing import SigningKey
from playwright.sync_api import Page
from test_live_twin import Still
from tiny_twin import Twin

from ruffini.daemon import running_daemon
from ruffini.device import Connection
from ruffini.sim.scenario import Scenario
from ruffini.sim.serve import TwinServer


def test_a_calibration_is_flashed_or_refused_and_nothing_happens_before_it_is_asked_for(
    page: Page, twin: Twin, tmp_path: Path
) -> None:
    good, spoilt = tmp_path / "good.safetensors", tmp_path / "spoilt.safetensors"
    good.write_bytes(twin.calibration)
    spoilt.write_bytes(twin.calibration[:-1] + bytes([twin.calibration[-1] ^ 1]))
    assert twin.board.folder is not None
    with (
        TwinServer(twin.unit.renderer(), Still(twin), Scenario(), tmp_path / "twin"),
        running_daemon(twin.board.folder, f"twin:{tmp_path / 'twin'}", tmp_path / "store") as port,
    ):
        with viewer(port) as address:
            page.goto(address)
            wait_for(page, "no calibration", lambda s: sensor_of(s)["wrench"]["validity"] == [0] * 6)
            page.set_input_files("#calibration", spoilt)
            assert "has no calibration yet" in page.inner_text("#flash-what")
            page.click("#flash-go")
            page.wait_for_selector("#flash-said.bad")
            assert "signature" in page.inner_text("#flash-said")
            page.click("#flash-close")
            page.set_input_files("#calibration", good)
            page.click("#flash-close")  # thought better of it
            assert not sensor_of(wait_for(page, "a state", lambda s: True))["calibration"]["isPresent"]
            page.set_input_files("#calibration", good)
            page.click("#flash-go")
            wait_for(page, "the end", lambda s: page.inner_text("#flash-said").startswith("It is in force"))
            wait_for(page, "what is in force", lambda s: sensor_of(s)["calibration"]["isPresent"])
            wait_for(page, "forces", lambda s: sensor_of(s)["wrench"]["validity"] == [1] * 6)
        with Connection(port) as sensor:
            assert sensor.hello.sensors[0].calibration.present
            assert not sensor.hello.sensors[0].calibration.on_trial


def test_a_sensor_that_only_its_owners_change_says_so_and_what_to_do(page: Page, twin: Twin, tmp_path: Path) -> None:
    (tmp_path / "good.safetensors").write_bytes(twin.calibration)
    (tmp_path / "card").mkdir()
    key = SigningKey.generate().verify_key.encode()
    (tmp_path / "card" / "lab.pub").write_text(key.hex() + "\n")
    assert twin.board.folder is not None
    with (
        TwinServer(twin.unit.renderer(), Still(twin), Scenario(), tmp_path / "twin"),
        running_daemon(
            twin.board.folder, f"twin:{tmp_path / 'twin'}", tmp_path / "store", "--keys", str(tmp_path / "card")
        ) as port,
        viewer(port) as address,
    ):
        page.goto(address)
        wait_for(page, "the sensor", lambda s: sensor_of(s)["wrench"]["validity"])
        page.set_input_files("#calibration", tmp_path / "good.safetensors")
        said = page.inner_text("#flash-said.bad")
        key_id = hashlib.sha256(key).hexdigest()[:8]
        assert f"(key {key_id})" in said
        assert "ruffini cal flash good.safetensors --key NAME" in said
        assert not page.is_visible("#flash-go")
        page.click("#flash-close")
        page.keyboard.press("z")
        wait_for(page, "what to do", lambda s: "ruffini cal zero" in s["notice"])
