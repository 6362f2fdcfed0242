"""Every verb: one JSON object with --json, documented exit codes, and a fast --help."""

from __future__ import annotations

import json
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hang import HANG_S
from test_bad_input import HOST, is_one_sentence, run_host
from tiny_sensor import N_FRAMES, N_REST, Sensor, draw, start

SLOW_MHZ = 15_000  # 256 frames then take 17 s, in which a busy computer takes a picture, too
MOST_LATE = 40  # zeros refused because the camera seems to stand still: it is slow, and so is a busy computer


def ask(*arguments: str, port: str | None = None) -> dict[str, object]:
    """The one JSON object of a verb that succeeds."""
    code, out, text = run_host(*arguments, "--json", port=port)
    assert code == 0, text
    result = json.loads(out)
    assert isinstance(result, dict)
    return result


def test_help_names_the_exit_codes() -> None:
    code, out, _ = run_host("--help")
    assert code == 0
    assert "Exit codes" in out


def test_every_verb_has_json_and_help() -> None:
    import typer.main

    from ruffini.cli.app import app

    def leaves(command: object, path: tuple[str, ...]) -> list[tuple[tuple[str, ...], object]]:
        children = getattr(command, "commands", None)
        if children is None:
            return [] if command.hidden else [(path, command)]  # type: ignore[attr-defined]
        return [leaf for name, child in children.items() for leaf in leaves(child, (*path, name))]

    verbs = leaves(typer.main.get_command(app), ())
    assert 20 <= len(verbs) <= 40
    for path, command in verbs:
        options = {o for parameter in command.params for o in parameter.opts}  # type: ignore[attr-defined]
        assert "--json" in options, path
        assert command.help, path  # type: ignore[attr-defined]


def test_a_wrong_option_is_usage() -> None:
    assert run_host("info", "--nonsense")[0] == 2
    assert run_host("nonsense")[0] == 2
    for verb in (["monitor", "--n", "-1"], ["record", "x", "--image-every", "-1"], ["cal", "zero", "--n", "-1"]):
        code, _, text = run_host(*verb)
        assert (code, "Traceback" in text) == (2, False), verb


def test_boards(sensor: Sensor) -> None:
    assert "gelslim" in ask("board", "list")["boards"]  # type: ignore[operator]
    assert ask("board", "check", str(sensor.folder)) == {"board": "tiny", "ok": True}
    assert ask("board", "show", "gelslim")["board"]["name"] == "gelslim"  # type: ignore[index]


def test_calibrate_check_and_flash(sensor: Sensor, tmp_path: Path) -> None:
    operator, colours, both = (tmp_path / f"{n}.safetensors" for n in ("operator", "colours", "both"))
    made = ask(
        "cal", "fit", "--only", "operator", "--board", str(sensor.folder), "--method", "ridge", "--out", str(operator)
    )
    assert made["method"] == "ridge"
    colours.write_bytes(sensor.calibration)
    assert set(ask("cal", "file", "merge", str(colours), str(operator), "--out", str(both))["kinds"]) >= {  # type: ignore[call-overload]
        "operator",
        "photometric",
    }
    assert ask("cal", "file", "verify", str(both), "--board", str(sensor.folder))["ok"] is True
    assert ask("cal", "file", "show", str(both))["metadata"]["board"] == "tiny"  # type: ignore[index]
    with start(sensor, tmp_path / "store", "--wait-for-host") as daemon:
        assert ask("cal", "flash", str(both), "--dry-run", port=daemon.port)["state"] == "dry-run"
        assert ask("cal", "flash", str(both), port=daemon.port)["state"] == "active"
        assert ask("cal", "flash", str(both), port=daemon.port)["state"] == "same"
        assert ask("cal", "zero", "--even-if-touched", "--no-wait", port=daemon.port)["ok"] is True
        assert ask("info", port=daemon.port)["serial"] == "0001"
        assert ask("devices", port=daemon.port)["devices"][0]["boards"] == ["tiny"]  # type: ignore[index]


def test_watch(sensor: Sensor, tmp_path: Path) -> None:
    with start(sensor, tmp_path / "store", "--loop") as daemon:
        path = tmp_path / "c.safetensors"
        path.write_bytes(sensor.calibration)
        ask("cal", "flash", str(path), port=daemon.port)
        code, out, _ = run_host("monitor", "--n", "12", "--json", port=daemon.port)
        lines = [json.loads(line) for line in out.splitlines()]
        assert code == 0
        assert len(lines) == 12
        assert all(line["simulated"] and line["replay"] for line in lines)
        # Parts of frames are left out for a reader that has no turn.
        told = [line for line in lines if line["contacts"] is not None]
        assert told
        assert all(line["contacts"]["frame"] == line["frame"] for line in told)
        picture = tmp_path / "snapshot.png"
        shown = ask("snapshot", "--out", str(picture), port=daemon.port)
        assert (shown["file"], shown["simulated"], shown["validity"]) == (str(picture), True, [1, 1, 1])
        assert set(shown["nodes"]) == {"stick", "slip"}  # type: ignore[call-overload]
        assert cv2.imread(str(picture)) is not None
        recording = tmp_path / "run.mcap"
        counts = ask("record", str(recording), "--n", "5", port=daemon.port)["messages"]
        assert counts["WRENCH"] >= 5  # type: ignore[index]


def test_a_snapshot_says_what_is_not_measured_and_what_is_not_valid(sensor: Sensor, tmp_path: Path) -> None:
    slow = tmp_path / "slow"
    shutil.copytree(sensor.recording, slow)
    about = (slow / "recording.toml").read_text()
    assert "rate_mhz = 100000" in about
    (slow / "recording.toml").write_text(about.replace("rate_mhz = 100000", f"rate_mhz = {SLOW_MHZ}"))
    with start(replace(sensor, recording=slow), tmp_path / "store", "--loop") as daemon:
        shown = ask("snapshot", "--out", str(tmp_path / "a.png"), port=daemon.port)
        assert shown["force_n"] == [None] * 3
        assert {"FLAG_UNCALIBRATED_XY", "FLAG_UNCALIBRATED_Z"} <= set(shown["flags"])  # type: ignore[call-overload]
        path = tmp_path / "c.safetensors"
        path.write_bytes(sensor.calibration)
        ask("cal", "flash", str(path), port=daemon.port)
        for _ in range(MOST_LATE):
            code, _, text = run_host("cal", "zero", "--n", "256", "--even-if-touched", "--no-wait", port=daemon.port)
            if "stands still" not in text:
                break
        assert code == 0, text
        code, out, _ = run_host("snapshot", "--out", str(tmp_path / "b.png"), port=daemon.port)
        assert code == 0
        assert "INVALID" in out
        assert "NO_REFERENCE" in out


def test_track(sensor: Sensor, tmp_path: Path) -> None:
    out = tmp_path / "track.npz"
    result = ask("offline", "track", str(sensor.recording), "--board", str(sensor.folder), "--out", str(out))
    assert result["frames"] == N_FRAMES
    assert result["markers_at_rest"] == 63
    moved = np.load(out)["displacement_px"]
    assert np.abs(moved[sensor.board.pipeline.n_rest_frames : N_REST]).max() < 0.15
    assert np.abs(moved[-1]).max() > 0.2


def test_depth(sensor: Sensor, tmp_path: Path) -> None:
    file = tmp_path / "c.safetensors"
    file.write_bytes(sensor.calibration)
    cv2.imwrite(str(tmp_path / "reference.png"), draw(sensor.board, 0.0, 1))
    cv2.imwrite(str(tmp_path / "pressed.png"), draw(sensor.board, 0.25, 2))
    out = tmp_path / "depth"
    command = [
        "offline",
        "depth",
        "--calibration",
        str(file),
        "--board",
        str(sensor.folder),
        str(tmp_path / "pressed.png"),
    ]
    result = ask(*command, "--out", str(out))
    assert result["images"][0]["lowest_um"] < -300  # type: ignore[index]
    depth = np.load(out / "pressed.npy")
    assert depth.shape == (120, 160)
    assert depth.argmin() // 160 == pytest.approx(60, abs=5)
    (tmp_path / "reference.png").unlink()
    code, _, text = run_host(*command)
    assert (code, is_one_sentence(text)) == (2, True)
    assert "--reference" in text


def test_field_is_the_devices_solve(sensor: Sensor, tmp_path: Path) -> None:
    file = tmp_path / "c.safetensors"
    file.write_bytes(sensor.calibration)
    u = np.zeros((3, 13, 17, 3))
    y, x = np.mgrid[-6:7, -8:9]
    u[1, :, :, 2] = -0.8 * np.exp(-(x**2 + y**2) / 8)  # far above the threshold: its rim counts little
    u[2] = 2 * u[1]
    np.save(tmp_path / "u.npy", u)
    command = ["offline", "field", "--calibration", str(file), "--board", str(sensor.folder)]
    files = ["--displacement", str(tmp_path / "u.npy"), "--out", str(tmp_path / "f.npy")]
    result = ask(*command, *files)
    force = np.load(tmp_path / "f.npy")
    assert force.shape == u.shape
    assert not force[0].any()
    total = force.sum(axis=(1, 2))
    np.testing.assert_allclose(total, result["resultant_n"], atol=1e-6)  # type: ignore[arg-type]
    assert total[1, 2] < -0.1
    assert total[2, 2] == pytest.approx(2 * total[1, 2], rel=0.1)  # the support grows with the load


SPOILT = {
    "wrong shape": (np.zeros((2, 5, 5, 3)), "needs float (frames, 13, 17, 3)"),
    "no frames axis": (np.zeros((13, 17, 3)), "needs float"),
    "integers": (np.zeros((1, 13, 17, 3), int), "needs float"),
    "not a number": (np.full((1, 13, 17, 3), np.nan), "holds NaN"),
    "metres taken for millimetres": (np.full((1, 13, 17, 3), 5.0), "more than 4.096 mm"),
}


@pytest.mark.parametrize("case", SPOILT, ids=str)
def test_field_refuses(case: str, sensor: Sensor, tmp_path: Path) -> None:
    values, words = SPOILT[case]
    (tmp_path / "c.safetensors").write_bytes(sensor.calibration)
    np.save(tmp_path / "u.npy", values)
    code, _, text = run_host(
        "offline", "field", "--calibration", str(tmp_path / "c.safetensors"), "--board", str(sensor.folder),
        "--displacement", str(tmp_path / "u.npy"), "--out", str(tmp_path / "f.npy"),
    )  # fmt: skip
    assert (code, is_one_sentence(text)) == (2, True)
    assert words in text
    assert not (tmp_path / "f.npy").exists()


OFFLINE = {
    "track without a video": (["offline", "track", "NOTHING.mp4", "--board", "gelslim"], 2),
    "track with another board": (["offline", "track", "RECORDING", "--board", "gelslim"], 2),
    "field with a calibration of another board": (
        ["offline", "field", "--calibration", "CALIBRATION", "--board", "gelslim", "--displacement", "X",
         "--out", "Y"], 4,
    ),
    "depth of a picture that is none": (
        ["offline", "depth", "--calibration", "CALIBRATION", "--board", "BOARD",
         "CALIBRATION", "--reference", "CALIBRATION"], 2,
    ),
    "an operator of an unknown method": (["cal", "fit", "--only", "operator", "--board", "BOARD",
     "--out", "Y", "--method", "magic"], 2),
    "an operator of negative noise": (
        ["cal", "fit", "--only", "operator", "--board", "BOARD", "--out", "Y", "--noise-um", "5,-5,20"], 2,
    ),
    "verify of something else": (["cal", "file", "verify", "PICTURE"], 2),
}  # fmt: skip


@pytest.mark.parametrize("case", OFFLINE, ids=str)
def test_offline_verbs_refuse_with_one_sentence(case: str, sensor: Sensor, tmp_path: Path) -> None:
    (tmp_path / "c.safetensors").write_bytes(sensor.calibration)
    names = {
        "RECORDING": str(sensor.recording), "CALIBRATION": str(tmp_path / "c.safetensors"),
        "BOARD": str(sensor.folder), "PICTURE": str(next((sensor.recording / "frames").iterdir())),
        "X": str(tmp_path / "x"), "Y": str(tmp_path / "y"),
    }  # fmt: skip
    arguments, wanted = OFFLINE[case]
    code, _, text = run_host(*[names.get(a, a) for a in arguments])
    assert is_one_sentence(text), text
    assert code == wanted, text
    assert not (tmp_path / "y").exists()


def test_ctrl_c_ends_monitor_without_a_traceback(sensor: Sensor, tmp_path: Path) -> None:
    import signal

    with start(sensor, tmp_path, "--loop") as daemon:
        process = subprocess.Popen(
            [*HOST, "--port", daemon.port, "monitor"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        assert process.stdout is not None
        process.stdout.readline()
        process.send_signal(signal.SIGINT)
        _, text = process.communicate(timeout=HANG_S)
    assert process.returncode == 130
    assert "Traceback" not in text
