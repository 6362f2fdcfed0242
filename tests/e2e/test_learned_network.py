"""A learned network beside the frame path: the real ruffinid, a network of a few hundred bytes, a real pty.

`means.onnx` (tests/data/networks/make_networks.py) says the mean of blue times 1000, and of green less red.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from hang import HANG_S
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from tiny_sensor import ROOT, Sensor, start, write_board, write_recording
from typer.testing import CliRunner

from ruffini.boards import find_board
from ruffini.cli.app import app
from ruffini.device import Connection, Learned
from ruffini.record import record_stream

NETWORKS = ROOT / "tests" / "data" / "networks"
N_FRAMES = 16
RUNS, FAILED = 1, 2


@pytest.fixture(scope="module")
def asking(tmp_path_factory: pytest.TempPathFactory) -> Sensor:
    """A board that asks for a network, and frames: a press that grows, once the lens covered by something red."""
    root = tmp_path_factory.mktemp("asking")
    changes = {'name = "sample"': 'name = "round"', 'optics = "gelslim-twin-320x240"': 'optics = "test"'}
    folder = write_board(root / "round", changes)
    with (folder / "board.toml").open("a") as file:
        file.write('\n[learned]\nnetwork = "net.onnx"\n')
    board = find_board(folder)
    recording = write_recording(board, root / "recording", N_FRAMES)
    red = np.full((board.camera.height_px, board.camera.width_px, 3), (0, 0, 200), np.uint8)
    cv2.imwrite(str(recording / "frames" / f"{N_FRAMES - 2:04d}.png"), red)
    return Sensor(board, folder, recording, b"")


def test_what_it_says_arrives_with_its_own_frames_stamp_and_is_recorded(asking: Sensor, tmp_path: Path) -> None:
    store, out = tmp_path / "store", tmp_path / "run.mcap"
    store.mkdir()
    shutil.copy(NETWORKS / "means.onnx", store / "net.onnx")
    with start(asking, store, "--lockstep", "--wait-for-host", "--linger") as daemon, Connection(daemon.port) as host:
        record_stream(host, out, n_frames=N_FRAMES)  # to the last frame's markers: what the network says is later
        host._send("STATUS")
        status = next(m for f, m in host.stream(timeout_s=HANG_S) if host.schema.type_name(f.type) == "STATUS")
        host.subscribe()
    with out.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        said = [Learned.from_message(m) for *_, m in reader.iter_decoded_messages(topics=["/ruffini/learned"])]
    assert [s.frame for s in said] == list(range(N_FRAMES - 1))
    for i, one in enumerate(said):
        picture = cv2.imread(str(asking.recording / "frames" / f"{i:04d}.png"))
        blue, green, red = picture.reshape(-1, 3).mean(axis=0)
        assert one.quantities == {
            "blue_un": pytest.approx(1000 * blue, abs=1),
            "green_um": pytest.approx(green - red, abs=0.6),
        }
        taught = 0 <= 1000 * blue <= 140_000 and -50 <= green - red <= 50
        assert one.is_valid == taught
        assert 0 < one.took_s <= one.latency_s < 30
        assert (one.rate_hz > 0) == (i > 0)
    assert [s.frame for s in said if not s.is_valid] == [N_FRAMES - 2]
    network = status.network
    assert (network.state, network.results, network.skipped) == (RUNS, N_FRAMES, 0)
    assert network.invalid == sum(not s.is_valid for s in said)  # the last frame is as all but the red one
    assert network.sha256 == hashlib.sha256((store / "net.onnx").read_bytes()).digest()
    assert "HEALTH_NETWORK" not in host.schema.enum_names("HealthBit", status.health)


def test_monitor_shows_what_it_last_said(asking: Sensor, tmp_path: Path) -> None:
    store = tmp_path / "store"
    store.mkdir()
    shutil.copy(NETWORKS / "means.onnx", store / "net.onnx")
    for words in (["--json"], []):
        with start(asking, store, "--lockstep", "--wait-for-host", "--linger") as daemon:
            done = CliRunner().invoke(app, ["--port", daemon.port, "monitor", "--n", "4", *words])
        assert done.exit_code == 0, done.output
        last = done.stdout.strip().splitlines()[-1]
        if words:
            row = json.loads(last)
            assert row["learned"]["frame"] == row["frame"] - 1  # it comes behind a frame's other messages
            assert set(row["learned"]["quantities"]) == {"blue_un", "green_um"}
        else:
            assert "| network: blue_un 1" in last
            assert " of frame 2, " in last


def test_info_shows_how_it_fares(asking: Sensor, tmp_path: Path) -> None:
    store, said = tmp_path / "store", {}
    store.mkdir()
    for name, file in (("runs", "means.onnx"), ("fails", "small.onnx")):
        shutil.copy(NETWORKS / file, store / "net.onnx")
        with start(asking, store, "--lockstep", "--linger") as daemon:
            with Connection(daemon.port) as host:
                host.subscribe(wrench=1)
                while host.status().frames_processed < N_FRAMES:
                    pass
            for words in ([], ["--json"]):
                done = CliRunner().invoke(app, ["--port", daemon.port, "info", *words])
                assert done.exit_code == 0, done.output
                said[name, bool(words)] = done.stdout
    network = json.loads(said["runs", True])["network"]
    assert (network["state"], network["results"], network["problem"]) == ("runs", N_FRAMES, "")
    assert 0 < network["took_s"] <= network["latency_s"]
    assert network["rate_hz"] > 0
    assert f"network: runs, {network['rate_hz']:.1f} Hz, takes " in said["runs", False]
    assert f"{N_FRAMES} results, 1 invalid, 0 frames skipped" in said["runs", False]
    assert json.loads(said["fails", True])["network"]["state"] == "failed"
    assert "network: failed: the network does not run on this board's frames" in said["fails", False]


def nothing(path: Path) -> None:
    """No file at all."""


PROBLEMS: dict[str, tuple[Callable[[Path], object], str]] = {
    "no file": (nothing, "net.onnx: no such network"),
    "garbage": (lambda p: p.write_bytes(b"garbage" * 99), "no network of ruffini"),
    "another board": (
        lambda p: p.write_bytes((NETWORKS / "means.onnx").read_bytes().replace(b"round", b"other")), "train its own"
    ),
    "another size": (lambda p: shutil.copy(NETWORKS / "small.onnx", p), "does not run on this board's frames"),
    "fewer outputs": (lambda p: shutil.copy(NETWORKS / "short.onnx", p), "2 outputs"),
}  # fmt: skip


@pytest.mark.parametrize("name", PROBLEMS)
def test_frames_go_on_without_a_network_that_does_not_run(asking: Sensor, tmp_path: Path, name: str) -> None:
    make, problem = PROBLEMS[name]
    store = tmp_path / "store"
    store.mkdir()
    make(store / "net.onnx")
    counts = {"WRENCH": 0, "LEARNED": 0}
    with start(asking, store, "--lockstep", "--wait-for-host", "--linger") as daemon, Connection(daemon.port) as host:
        host.subscribe(wrench=1, learned=1)
        for frame, message in host.stream(timeout_s=HANG_S):
            kind = host.schema.type_name(frame.type)
            if kind == "STATUS":
                status = message
                break
            counts[str(kind)] += 1
            if counts["WRENCH"] == N_FRAMES:
                host._send("STATUS")
    assert counts == {"WRENCH": N_FRAMES, "LEARNED": 0}
    assert status.network.state == FAILED
    assert problem in status.network.problem
    assert "HEALTH_NETWORK" in host.schema.enum_names("HealthBit", status.health)


def test_no_number_is_invalid_and_frames_go_on(asking: Sensor, tmp_path: Path) -> None:
    store = tmp_path / "store"
    store.mkdir()
    shutil.copy(NETWORKS / "nan.onnx", store / "net.onnx")
    said = []
    with start(asking, store, "--lockstep", "--wait-for-host", "--linger") as daemon, Connection(daemon.port) as host:
        host.subscribe(learned=1)
        for _, message in host.stream(timeout_s=HANG_S):
            said.append(Learned.from_message(message))
            if len(said) == N_FRAMES:
                break
    assert not any(s.is_valid or s.quantities for s in said)


@pytest.mark.parametrize("mode", [1, 3])
def test_an_exported_network_says_on_the_board_what_pytorch_says(tmp_path: Path, mode: int) -> None:
    torch = pytest.importorskip("torch", reason="needs the extra [train]")
    pytest.importorskip("onnx", reason="needs the extra [train]")
    from dataclasses import replace

    from ruffini.train.stereo_export import onnx_of
    from ruffini.train.stereo_network import PLANS, StereoNet

    own = find_board("stereo-fingertip")
    assert own.folder is not None
    folder, recording, store = tmp_path / own.name, tmp_path / "recording", tmp_path / "store"
    shutil.copytree(own.folder, folder)
    with (folder / "board.toml").open("a") as file:
        file.write('\n[learned]\nnetwork = "net.onnx"\n')
    (recording / "frames").mkdir(parents=True)
    store.mkdir()
    rng = np.random.default_rng(4)
    pictures = rng.integers(0, 80, (4, own.camera.height_px, own.camera.width_px, 3)).astype(np.uint8)
    for i, picture in enumerate(pictures):
        picture[:, 40 * i :: 160] += 120  # lines that stand elsewhere in each view
        picture[: 40 * i] += 40
    for i, picture in enumerate(pictures):
        cv2.imwrite(str(recording / "frames" / f"{i:04d}.png"), picture)
    torch.manual_seed(2)
    low, high = np.array([0.0, 0, -6e3, -6e3, -1e6, -1e6]), np.array([1e6, 2e3, 6e3, 6e3, 1e6, 1e6])
    net = StereoNet(replace(PLANS["eighth"], widths=(4, 4, 4, 4, 4), units=16), mode, low, high)
    given = torch.from_numpy(np.moveaxis(pictures, -1, 1).astype(np.float32))
    with torch.no_grad():
        for _ in range(30):
            net(given)  # batch norm learns what is usual
        expected = net.eval()(given).numpy()
    metadata = {
        "ruffini.format": "ruffini-network", "ruffini.format_version": "1", "ruffini.board": own.name,
        "ruffini.optics": own.camera.optics, "ruffini.resolution": "640x240",
        "ruffini.outputs": "force_un,way_um,x_um,y_um,roll_urad,pitch_urad",
        "ruffini.low": "-9000000," * 5 + "-9000000", "ruffini.high": "9000000," * 5 + "9000000",
    }  # fmt: skip
    (store / "net.onnx").write_bytes(onnx_of(net, own, metadata))
    said = []
    sensor = Sensor(own, folder, recording, b"")
    with start(sensor, store, "--lockstep", "--wait-for-host", "--linger") as daemon, Connection(daemon.port) as host:
        host.subscribe(learned=1)
        for _, message in host.stream(timeout_s=HANG_S):
            said.append(Learned.from_message(message))
            if len(said) == len(pictures):
                break
    assert len(said) == len(pictures)
    assert all(s.is_valid for s in said)
    for one, row in zip(said, expected, strict=True):
        assert list(one.quantities) == metadata["ruffini.outputs"].split(",")
        assert np.array(list(one.quantities.values())) == pytest.approx(row, abs=1)  # it sends integers
    assert np.ptp(expected, axis=0).min() > 1
