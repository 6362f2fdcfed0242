"""Frames into Rerun: on a FAKE of its module always, and into a real file where rerun-sdk is installed."""

from __future__ import annotations

import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_frames import FORCE, NODES, frame

from ruffini.view.rerun_sink import RerunSink, grid_triangles


class FakeStream:
    """Keeps what is logged, by entity."""

    def __init__(self) -> None:
        self.times: dict[str, Any] = {}
        self.logged: dict[str, list[Any]] = {}

    def set_time(self, timeline: str, **at: Any) -> None:
        self.times[timeline] = at

    def log(self, path: str, entity: Any, *, static: bool = False) -> None:
        self.logged.setdefault(path, []).append(entity)


def archetype(name: str) -> Any:
    return lambda *values, **named: types.SimpleNamespace(kind=name, values=values, **named)


KINDS = ("Arrows3D", "DepthImage", "Image", "Mesh3D", "Scalars", "SeriesLines", "Tensor", "TextLog")
FAKE = types.SimpleNamespace(ViewCoordinates=types.SimpleNamespace(RDF="RDF"), **{k: archetype(k) for k in KINDS})


def logged(*frames: Any) -> tuple[FakeStream, dict[str, Any]]:
    """The stream, and by entity below the pad what was logged last."""
    stream = FakeStream()
    sink = RerunSink(FAKE, stream, "ruffini_1", {0: NODES}, arrow_m_per_n=0.5)
    for one in frames:
        sink.put(one)
    return stream, {path.rpartition("/")[2]: entities[-1] for path, entities in stream.logged.items()}


def test_a_valid_frame_is_drawn_in_si_units() -> None:
    stream, got = logged(frame(is_simulated=False))
    assert all(path.startswith("ruffini_1/pad0") for path in stream.logged)
    assert stream.times["camera frame"] == {"sequence": 420}
    assert stream.times["captured"]["timestamp"] > 1e9
    np.testing.assert_allclose(got["force_n"].values[0], [1e-3, -2e-3, -3e-3])
    np.testing.assert_allclose(got["force"].vectors, 0.5e-5 * FORCE.reshape(-1, 3))
    np.testing.assert_allclose(got["surface"].vertex_positions[:, 2], FORCE[..., 2].ravel() * 1e-7, atol=1e-12)
    np.testing.assert_allclose(got["force"].origins, got["surface"].vertex_positions)
    np.testing.assert_allclose(got["pressed_in"].values[0].ravel(), np.arange(12) * 1e-6, rtol=1e-5)
    assert len(got["total"].vectors) == 1
    assert "flags" not in got


def test_what_is_not_valid_is_not_drawn_and_says_why() -> None:
    bad = frame(validity=(1, 1, 3, 1, 1, 1), flags=1024)
    stream, got = logged(frame(), bad, bad)
    assert len(got["force"].vectors) == len(got["total"].vectors) == 0
    assert np.isnan(got["force_n"].values[0][2])
    assert np.isnan(got["pressed_in"].values[0]).all()
    said = stream.logged["simulated_ruffini_1/pad0/flags"]
    assert [(m.values[0], m.level) for m in said] == [
        ("SIMULATED: no force here was measured", "WARN"),
        ("forces are not valid, FLAG_LIGHT", "WARN"),
    ]


def test_triangles_cover_the_grid_once() -> None:
    corners = NODES.reshape(-1, 2)[grid_triangles(3, 2)]
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    areas = (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2
    assert (areas > 0).all()
    assert areas.sum() == pytest.approx(2e-3 * 2e-3)


def test_a_real_file_has_what_was_logged(tmp_path: Path) -> None:
    rr = pytest.importorskip("rerun", reason="extra [rerun] is not installed: 500 MB")
    stream = rr.RecordingStream("ruffini")
    stream.save(tmp_path / "a.rrd")
    sink = RerunSink(rr, stream, "ruffini_1", {0: NODES}, arrow_m_per_n=0.5)
    sink.put(frame())
    sink.put(frame(validity=(1, 1, 3, 1, 1, 1), flags=1024))
    stream.flush()
    stream.disconnect()
    data = (tmp_path / "a.rrd").read_bytes()
    assert data.startswith(b"RRF")
    for entity in ("force", "surface", "total", "force_n", "pressed_in", "flags"):
        assert f"/simulated_ruffini_1/pad0/{entity}".encode() in data, entity
