"""From the real daemon's line to a zenoh subscriber that hears what a node with rmw_zenoh would. No ROS takes part."""

from __future__ import annotations

import json
import math
import os
import signal
import socket
import struct
import subprocess
import sys
import time
import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh
from daemon_time import DaemonTime
from hang import HANG_S, until
from tiny_sensor import N_FRAMES, ROOT, Sensor, start

from ruffini.api.frame import SETTLED
from ruffini.device import Connection
from ruffini.ros.cdr import Types
from ruffini.ros.messages import ERROR, STALE, TOPICS

RUFFINI = str(Path(sys.executable).parent / "ruffini")
README = ROOT / "host" / "ruffini" / "ros" / "README.md"
DOMAIN = 42
CLOCKS_NS = 600 * 10**9
N_SENT = 2 * N_FRAMES
TYPES = Types()


def free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


def listening() -> tuple[str, Any] | None:
    """An endpoint of this test's own and the session that listens there; None where another run was faster."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    config = zenoh.Config()
    config.insert_json5("mode", '"peer"')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("listen/endpoints", f'["{endpoint}"]')
    try:
        return endpoint, zenoh.open(config)
    except zenoh.ZError:
        return None


class Listener:
    """Hears all samples and tokens of the domain; where the bridge connects to."""

    def __init__(self) -> None:
        self.endpoint, self.session = until(listening, "a free port")
        self.samples: dict[str, list[tuple[str, bytes, bytes]]] = defaultdict(list)  # by topic: key, bytes, attachment
        self.tokens: set[str] = set()
        self._kept = [
            self.session.declare_subscriber(f"{DOMAIN}/**", self._hear),
            self.session.liveliness().declare_subscriber(f"@ros2_lv/{DOMAIN}/**", self._see),
        ]

    def _hear(self, sample: Any) -> None:
        topic = "/".join(str(sample.key_expr).split("/")[1:-2])
        self.samples[topic].append((str(sample.key_expr), bytes(sample.payload), bytes(sample.attachment)))

    def _see(self, sample: Any) -> None:
        is_there = sample.kind == zenoh.SampleKind.PUT
        (self.tokens.add if is_there else self.tokens.discard)(str(sample.key_expr))

    def number(self, topic: str) -> int:
        """Of the last message, as its publisher counts them from 1; 0: none came."""
        came = self.samples[topic]
        return int(struct.unpack_from("<q", came[-1][2])[0]) if came else 0

    def frame(self, base: str) -> int:
        """Number of the last frame that arrived; -1: none did."""
        came = self.messages(f"{base}/measurement", last=1)
        return int(came[0].frame) if came else -1

    def stamp(self, topic: str) -> Any:
        """Of the last message."""
        return self.messages(topic, last=1)[0].header.stamp

    def messages(self, topic: str, last: int = 0) -> list[Any]:
        """As rosbags' own deserialiser has them, by the type that the key names."""
        out = []
        for key, data, _ in self.samples[topic][-last:]:
            package, kind, _, name = key.split("/")[-2].split("::")
            out.append(TYPES.decode(data, f"{package}/{kind}/{name.rstrip('_')}"))
        return out


@pytest.fixture
def listener() -> Iterator[Listener]:
    made = Listener()
    yield made
    made.session.close()


def start_bridge(port: str, endpoint: str, *options: str) -> subprocess.Popen[str]:
    command = [RUFFINI, "--port", port, "ros2", "bridge", "--connect", endpoint, *options]
    env = {**os.environ, "ROS_DOMAIN_ID": str(DOMAIN)}
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=env)


def test_a_press_arrives_as_ros_messages(sensor: Sensor, listener: Listener, tmp_path: Path) -> None:
    base = "ruffini_0001"
    with start(sensor, tmp_path, "--lockstep", "--wait-for-host") as daemon, Connection(daemon.port) as host:
        host.flash(sensor.calibration)
    sensor_time = DaemonTime(tmp_path)
    with start(sensor, tmp_path, "--loop", "--wait-for-host", *sensor_time.options) as daemon:
        began_ns = time.time_ns()
        bridge = start_bridge(
            daemon.port, listener.endpoint, "--n-frames", str(N_SENT), "--residual-every", "1", "--json"
        )
        # No frame is captured before the one before was heard at the end of the chain: none is replaced on its way. The
        # bridge holds the first ones until it knows what belongs to a frame; those are given ten times their time, and
        # where that is too short for a busy computer, others follow in place of those that were replaced.
        until(lambda: listener.tokens, "the bridge")
        n_captured, n_published, tokens = 1, 0, set[str]()
        while n_published < N_SENT - 1:
            if n_captured <= SETTLED + 2:
                time.sleep(0.1)
            else:
                until(lambda n=n_captured: listener.frame(base) >= n - 1, f"frame {n_captured - 1}")
            n_published = listener.number(f"{base}/measurement")
            if n_published == N_SENT - 1:
                until(lambda: len(listener.samples["diagnostics"]) >= 2, "its health")
                tokens = set(listener.tokens)  # with the last frame it leaves
            sensor_time.advance(0.01)
            n_captured += 1
        until(lambda: listener.number(f"{base}/measurement") == N_SENT, "the last frame")
        until(lambda: listener.stamp(f"{base}/contacts") == listener.stamp(f"{base}/measurement"), "all of it")
        out, err = bridge.communicate(timeout=HANG_S)
    assert bridge.returncode == 0, err
    assert json.loads(out) == {"node": base, "frames": N_SENT}
    ended_ns = time.time_ns()

    assert {key for samples in listener.samples.values() for key, _, _ in samples} == {
        *(f"{DOMAIN}/{base}/{t.name}/{t.type.replace('/', '::').replace('msg::', 'msg::dds_::')}_/{TYPES.hash(t.type)}"
          for t in TOPICS if t.name not in ("learned", "softness")),
        f"{DOMAIN}/diagnostics/diagnostic_msgs::msg::dds_::DiagnosticArray_/"
        f"{TYPES.hash('diagnostic_msgs/msg/DiagnosticArray')}",
    }  # fmt: skip
    kinds = [token.split("/")[5] for token in tokens]
    assert sorted(kinds) == ["MP"] * (len(TOPICS) + 1) + ["NN"]
    until(lambda: not listener.tokens, "the node's leaving of the graph")

    clouds, sent = listener.messages(f"{base}/field"), listener.messages(f"{base}/wrench")
    stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in sent]
    assert all(m.header.frame_id == "simulated_ruffini_0001_pad" for m in (*sent, *clouds))
    cloud_of = {(c.header.stamp.sec, c.header.stamp.nanosec): c for c in clouds}
    # A publisher knows its listeners a moment after they know it: the first ones may have gone to nobody.
    assert len(sent) >= N_SENT - SETTLED
    # Of this day: the sensor's time stands still between its frames, so that no stamp can be right to the millisecond.
    assert began_ns - CLOCKS_NS < stamps[0] < stamps[-1] < ended_ns + CLOCKS_NS
    assert (np.diff(stamps) >= 0).all()
    n_valid = n_pressed = 0
    for m in sent[SETTLED:]:
        force, cloud = m.wrench.force, cloud_of[m.header.stamp.sec, m.header.stamp.nanosec]
        if math.isnan(force.z):  # rest is being learned
            continue
        n_valid += 1
        points = cloud.data.view("<f4").reshape(-1, len(cloud.fields))
        total = points[:, 3:6].astype(float).sum(axis=0)
        np.testing.assert_allclose(total, [force.x, force.y, force.z], atol=1e-5)
        n_pressed += force.z < -0.1
    assert n_valid >= N_SENT - sensor.board.pipeline.n_rest_frames - SETTLED
    assert n_pressed > N_SENT / 2

    for samples in listener.samples.values():
        numbers = [struct.unpack_from("<q", attached)[0] for _, _, attached in samples]
        assert all(len(attached) == 33 for _, _, attached in samples)
        settled = [n for n in numbers if n > SETTLED]
        assert settled == list(range(SETTLED + 1, numbers[-1] + 1)), "none was lost on the way"
    health = [s for m in listener.messages("diagnostics") for s in m.status]
    assert health
    assert all("SIMULATED" in s.message and s.hardware_id == "0001" for s in health[1:])


def test_without_a_calibration_there_is_no_number(sensor: Sensor, listener: Listener, tmp_path: Path) -> None:
    with start(sensor, tmp_path, "--loop") as daemon:
        bridge = start_bridge(daemon.port, listener.endpoint)

        def told() -> list[Any]:
            """A busy computer also says at times that no new picture comes."""
            return [m.status[0] for m in listener.messages("diagnostics") if m.status[0].level != STALE]

        until(
            lambda: len(listener.samples["ruffini_0001/measurement"]) >= 20 and told() and told()[-1].level == ERROR,
            "twenty measurements and what is wrong with them",
        )
        bridge.send_signal(signal.SIGINT)
        _, err = bridge.communicate(timeout=HANG_S)
    assert bridge.returncode == 0, err
    got = listener.messages("ruffini_0001/measurement")
    assert all(math.isnan(getattr(m.wrench.force, axis)) for m in got for axis in "xyz")
    assert {v for m in got for v in m.validity} == {0}
    assert np.isnan([m.covariance for m in got]).all()
    for m in listener.messages("ruffini_0001/field"):
        assert np.isnan(m.data.view("<f4").reshape(-1, len(m.fields))[:, 3:6]).all()
    assert told()[-1].level == ERROR
    assert "forces are not valid" in told()[-1].message


def test_the_frames_of_a_board_as_its_readme_asks_for_them() -> None:
    (asked,) = [line for line in README.read_text().splitlines() if line.startswith("ruffini ros2 urdf")]
    words = asked.partition("#")[0].split()[1:]
    robot = ET.fromstring(subprocess.run([RUFFINI, *words], capture_output=True, text=True, check=True).stdout)
    assert robot.get("name") == "ruffini_0001"
    assert [link.get("name") for link in robot.iter("link")][1] == "ruffini_0001_pad"


def test_the_messages_package_is_written_where_it_is_wanted(tmp_path: Path) -> None:
    command = [RUFFINI, "ros2", "messages", str(tmp_path)]
    assert "colcon build" in subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert (tmp_path / "ruffini_msgs" / "msg" / "Measurement.msg").is_file()
    again = subprocess.run(command, capture_output=True, text=True, check=False)
    assert again.returncode == 2
    assert "is there already" in again.stderr
