"""What is flashed can be taken back, and what fails its gates is not flashed: the real daemon on a pty."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_bad_input import run_host
from tiny_sensor import Sensor, start

from ruffini.calibrate import container
from ruffini.device import Connection, flashing


def judged(sensor: Sensor, path: Path, value: float) -> container.CalibrationFile:
    """The sensor's calibration with a report of one gate, at most 0.05."""
    file = container.unpack(sensor.calibration)
    text = f"{value} of the largest force"
    gate = {"name": "error", "ok": value <= 0.05, "value": value, "limit": 0.05, "text": text}
    made = container.pack(file.tensors, {**file.metadata, "residuals": json.dumps({"gates": [gate]})})
    container.write(path, made)
    return made


def test_nothing_is_flashed_that_fails_and_what_was_flashed_can_be_undone(sensor: Sensor, tmp_path: Path) -> None:
    good, bad = judged(sensor, tmp_path / "good", 0.01), judged(sensor, tmp_path / "bad", 0.2)

    def ask(port: str, *words: str) -> tuple[int, dict[str, str], str]:
        code, out, text = run_host("cal", *words, "--json", port=port)
        return code, json.loads(out) if out else {}, text

    with start(sensor, tmp_path / "store", "--wait-for-host") as daemon:
        port = daemon.port
        code, _, text = ask(port, "undo")
        assert code == 4, text
        assert "no calibration was in force before" in text
        code, result, text = ask(port, "flash", str(tmp_path / "good"))
        assert code == 0, text
        assert (result["state"], result["sha256"]) == ("active", good.sha256.hex())
        code, _, text = ask(port, "flash", str(tmp_path / "bad"))
        assert code == 4
        assert "error: 0.2 of the largest force" in text
        assert "--force" in text
        code, result, text = ask(port, "flash", str(tmp_path / "bad"), "--force")
        assert code == 0, text
        assert result["sha256"] == bad.sha256.hex()
        assert "FAILS ITS GATES" in text
        for wanted, replaced in ((good, bad), (bad, good), (good, bad)):
            code, result, _ = ask(port, "undo")
            assert (code, result["sha256"]) == (0, wanted.sha256.hex())
            assert result["replaced_sha256"] == replaced.sha256.hex()
    with start(sensor, tmp_path / "store", "--wait-for-host") as daemon:  # what was undone stays so
        code, result, _ = ask(daemon.port, "flash", str(tmp_path / "good"))
        assert (code, result["state"]) == (0, "same")


def test_an_answer_of_before_the_flash_is_not_taken_for_one_of_after_it(sensor: Sensor, tmp_path: Path) -> None:
    """On a busy computer HELLO is asked again before the first answer comes: then there are two."""
    with start(sensor, tmp_path / "store", "--wait-for-host") as daemon, Connection(daemon.port) as host:
        host._send("HELLO")
        host.flash(sensor.calibration)
        in_force = host.hello.sensors[0].calibration.sha256
    assert in_force == hashlib.sha256(sensor.calibration).digest()


def test_a_sensor_with_an_enrolled_key_takes_its_owners_files_only(sensor: Sensor, tmp_path: Path) -> None:
    own = {"RUFFINI_KEYS": str(tmp_path / "keys")}
    file = tmp_path / "calibration"
    container.write(file, container.unpack(sensor.calibration))

    def ask(*words: str, port: str | None = None) -> tuple[int, str, str]:
        return run_host(*words, port=port, **own)

    assert ask("key", "new", "lab")[0] == 0
    code, out, _ = ask("key", "show", "--json")
    key_id = json.loads(out)["keys"][0]["key_id"]
    assert ask("key", "enrol", "lab", str(tmp_path / "card"))[0] == 0
    options = ("--wait-for-host", "--keys", str(tmp_path / "card"))
    with start(sensor, tmp_path / "store", *options) as daemon:
        code, _, text = ask("cal", "flash", str(file), port=daemon.port)
        assert code == 4
        assert "signed with a key that is not enrolled here" in text
        code, _, text = ask("cal", "flash", str(file), "--key", "lab", port=daemon.port)
        assert code == 0, text
        with Connection(daemon.port) as host:
            assert host.hello.sensors[0].calibration.key_id == key_id
            host._send("STATUS")
            status = host._wait_for("STATUS", 3.0, lambda m: True)
            assert "HEALTH_DEVELOPMENT_KEY" not in host.schema.enum_names("HealthBit", status.health)
    assert ask("key", "sign", str(file), "--key", "lab", "--out", str(tmp_path / "signed"))[0] == 0
    code, out, _ = ask("cal", "file", "verify", str(tmp_path / "signed"), "--json")
    assert (code, json.loads(out)["signer"]) == (0, "lab")
    with start(sensor, tmp_path / "store2", "--wait-for-host") as daemon, Connection(daemon.port) as host:
        host._send("STATUS")
        status = host._wait_for("STATUS", 3.0, lambda m: True)
        assert "HEALTH_DEVELOPMENT_KEY" in host.schema.enum_names("HealthBit", status.health)


def test_versions_and_epochs_go_forward_and_a_file_for_another_sensor_is_refused(
    sensor: Sensor, tmp_path: Path
) -> None:
    file = tmp_path / "calibration"
    container.write(file, container.unpack(sensor.calibration))

    def flash(port: str, *words: str) -> tuple[int, str]:
        code, _, text = run_host("key", "sign", str(file), "--out", str(tmp_path / "signed"), *words)
        assert code == 0, text
        code, _, text = run_host("cal", "flash", str(tmp_path / "signed"), port=port)
        return code, text

    with start(sensor, tmp_path / "store", "--wait-for-host") as daemon:
        port = daemon.port
        code, text = flash(port, "--sensor", "0099")
        assert (code, 'for sensor "0099", this is "0001"' in text) == (4, True), text
        code, text = flash(port, "--version", "5000")
        assert (code, "--allow-jump" in text) == (4, True), text
        assert flash(port, "--version", "5", "--sensor", "0001")[0] == 0
        code, text = flash(port, "--version", "4")
        assert (code, "version 5 is in force" in text) == (4, True), text
        assert flash(port, "--version", "4", "--allow-older")[0] == 0
        assert flash(port, "--version", "6", "--epoch", "2")[0] == 0
        code, text = flash(port, "--version", "7", "--epoch", "1", "--allow-older", "--allow-jump")
        assert (code, "does not go back" in text) == (4, True), text
        code, _, text = run_host("cal", "undo", port=port)
        assert (code, "does not go back" in text) == (4, True), text
    assert (tmp_path / "store" / "calibration-3.epoch-2.safetensors").is_file()
    with start(sensor, tmp_path / "store", "--wait-for-host") as daemon:
        code, text = flash(daemon.port, "--version", "7", "--epoch", "0")
        assert (code, "this device is at 2" in text) == (4, True), text


def test_without_a_stored_calibration_the_factorys_is_in_force(sensor: Sensor, tmp_path: Path) -> None:
    factory = tmp_path / "factory.safetensors"
    factory.write_bytes(sensor.calibration)
    options = ("--wait-for-host", "--factory", str(factory))
    with start(sensor, tmp_path / "store", *options) as daemon, Connection(daemon.port) as host:
        assert host.hello.sensors[0].calibration.sha256 == hashlib.sha256(sensor.calibration).digest()


def test_before_a_flash_what_is_in_force_is_read_back_and_kept(
    sensor: Sensor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = container.unpack(sensor.calibration)
    container.write(tmp_path / "first", file)
    tensors = dict(file.tensors)
    slope = tensors["photometric.slope"].copy()
    slope[3, 4] += np.int16(7)
    second = container.pack({**tensors, "photometric.slope": slope}, {**file.metadata, "version": "2"})
    container.write(tmp_path / "second", second)
    kept = tmp_path / "kept"

    def flash(port: str, *words: str) -> tuple[int, dict[str, Any], str]:
        code, out, text = run_host("cal", "flash", *words, "--json", port=port, RUFFINI_BACKUPS=str(kept))
        return code, json.loads(out) if out else {}, text

    with start(sensor, tmp_path / "store", "--wait-for-host") as daemon:
        port = daemon.port
        code, result, text = flash(port, str(tmp_path / "first"), "--diff")
        assert (code, result["state"]) == (0, "diff"), text
        assert {"name": "board", "state": "added", "before": "", "after": "tiny"} in result["differences"]
        code, result, _ = flash(port, str(tmp_path / "first"))
        assert (code, "backup" in result) == (0, False), "there was nothing to keep"
        code, result, _ = flash(port, str(tmp_path / "second"), "--diff")
        assert result["differences"] == [
            {"name": "version", "state": "changed", "before": "1", "after": "2"},
            {"name": "photometric.slope", "state": "changed", "before": "int16 65x65x2",
             "after": "2 of 8450 numbers, by at most 7"},
        ]  # fmt: skip
        code, result, _ = flash(port, str(tmp_path / "second"), "--dry-run")
        assert (code, result["state"]) == (0, "dry-run")
        assert not kept.exists()
        code, result, text = flash(port, str(tmp_path / "second"))
        assert code == 0, text
        assert Path(result["backup"]).read_bytes() == sensor.calibration
        assert Path(result["backup"]).name.startswith("0001-")
        assert "is kept in" in text
        assert run_host("cal", "undo", port=port)[0] == 0
        code, result, _ = flash(port, str(tmp_path / "second"), "--backup", str(tmp_path / "second"))
        assert code == 2, "the folder is a file: nothing is flashed"
        code, result, _ = flash(port, str(tmp_path / "first"), "--no-backup")
        assert result["state"] == "same"
        asked: list[bytes] = []  # whether it is in force for good
        monkeypatch.setattr(flashing, "flash", lambda _, data, *__: asked.append(data))
        for words in (["--diff"], ["--dry-run"], []):
            assert asked == []
            code, result, _ = flash(port, str(tmp_path / "first"), *words)
            assert (code, result["state"]) == (0, "same")
        assert asked == [sensor.calibration]
        with Connection(port) as host:
            assert host.read_calibration() == sensor.calibration
