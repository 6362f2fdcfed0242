"""A stream and a CSV by another clock: joined on one clock, or told why not, and nothing lost."""

from __future__ import annotations

import contextlib
from types import SimpleNamespace

import numpy as np
import pytest

from ruffini.errors import InputError, NoDeviceError
from ruffini.rig.by_log import align, join, record
from ruffini.rig.csv_log import gauges_of
from ruffini.rig.found import on_reference_clock
from ruffini.rig.log_file import LogWriter, read_log
from ruffini.rig.stream_watch import ContactSample, FieldSample, ImageSample, MarkerSample, StreamSample, Window
from ruffini.rig.window_file import packed, read_window

OFFSET_S, DRIFT, LATE_S = 98765.4, 200e-6, 0.035


def pressed(t):
    """Presses of a person: every two to three seconds, each another size."""
    starts = np.cumsum([2.0, 2.3, 2.9, 2.1, 2.6, 3.1, 2.2, 2.4])
    sizes = [0.7, 1.3, 0.5, 1.1, 0.9, 1.5, 0.6, 1.2]
    return sum(s * np.clip(np.minimum(t - a, a + 1.4 - t) / 0.3, 0, 1) for a, s in zip(starts, sizes, strict=True))


def stream(*, is_blind: bool = False) -> Window:
    rng = np.random.default_rng(1)
    frames, markers = [], []
    for i, t in enumerate(np.arange(0, 24, 1 / 30)):
        wrench = np.array([0, 0, -0.7 * pressed(t) + 0.005 * rng.normal(), 0, 0, 0])
        frames.append(StreamSample(500 + t + LATE_S + 0.01 * rng.uniform(), 40 + t, i, 0,
                                   np.full(6, np.nan) if is_blind else wrench, (1,) * 6))  # fmt: skip
        markers.append(MarkerSample(40 + t, np.full((5, 2), pressed(t)) + 0.01 * rng.normal(size=(5, 2)), None))
    fields = [FieldSample(f.stream_s, np.ones((2, 3, 3))) for f in frames[::3]]
    contacts = [ContactSample(f.stream_s, 1, np.array([0.003, -0.002]), float(f.wrench[2]), np.array([0.1, 1e-3]))
                for f in frames if pressed(f.stream_s - 40) > 0]  # fmt: skip
    return Window(frames, fields, markers, [ImageSample(41.0, np.zeros((4, 4, 3), np.uint8), 1)], contacts, [])


def csv_text(*, header: str = "time_s,fz_N", part: slice = slice(None)) -> str:
    rng = np.random.default_rng(2)
    t = np.arange(-1, 25, 0.01)
    clock = OFFSET_S + t * (1 + DRIFT)
    rows = [f"{c:.5f},{-pressed(s) - 0.2 + 0.003 * rng.normal():.5f}" for c, s in zip(clock, t, strict=True)]
    return "\n".join([header, *rows[part]])


@pytest.fixture
def log(tmp_path):
    """A log whose stream was kept in two parts."""
    writer, window = LogWriter(tmp_path / "log.h5", {"program": "log"}), stream()
    for number, (low, high) in enumerate([(0, 52), (52, 99)]):
        writer.side_file(f"stream-{number:04d}.npz").write_bytes(packed(window.between(low, high), "run"))
    return writer


def test_joined_on_one_clock(log, tmp_path):
    path = tmp_path / "force.csv"
    path.write_text(csv_text())
    joined = join(log, path, {}, longest_gap_s=0.3)
    assert joined == (8, [])
    whole = read_log(tmp_path / "log.h5")
    clock = whole.found["csv_clock"]
    assert clock["drift"] == pytest.approx(DRIFT, abs=60e-6)
    assert clock["offset_s"] + clock["drift"] * (40 + 12 - clock["middle_s"]) == pytest.approx(
        OFFSET_S + 12 * (1 + DRIFT) - 52, abs=2e-3
    )
    touch = whole.touches[5]
    seen = np.interp(
        on_reference_clock(whole, touch), touch.arrays["reference_s"], touch.arrays["reference_wrench"][:, 2]
    )
    assert abs(seen + pressed(touch.arrays["stream_s"] - 40)).max() < 0.03
    assert touch.facts["kind"] == "log"
    assert len(touch.arrays["field_s"]) == 4
    assert (
        list(tmp_path.iterdir()) == [tmp_path / "force.csv", tmp_path / "log.h5"] or len(list(tmp_path.iterdir())) == 2
    )


def test_a_log_of_voltages_is_joined_as_wrenches(log, tmp_path):
    """Gauge 4 alone sees the normal force, 2 N a volt; its others are noise."""
    rng, rows = np.random.default_rng(3), csv_text().splitlines()[1:]
    volts = [(row.split(",")[0], *rng.normal(0, 1e-3, 6)) for row in rows]
    lines = [f"{t},{a},{b},{c},{d},{float(row.split(',')[1]) / 2 + e},{f}"
             for row, (t, a, b, c, d, e, f) in zip(rows, volts, strict=True)]  # fmt: skip
    path, names = tmp_path / "daq.csv", [f"gauge {i}" for i in range(6)]
    path.write_text("\n".join([",".join(["time_s", *names]), *lines]))
    matrix = 0.01 * np.eye(6)
    matrix[[2, 4]] = matrix[[4, 2]]
    matrix[2] *= 200
    joined = join(log, path, {}, longest_gap_s=0.3, gauges=gauges_of(names, matrix.tolist()))
    assert joined == (8, [])
    whole = read_log(tmp_path / "log.h5")
    touch = whole.touches[5]
    seen = np.interp(
        on_reference_clock(whole, touch), touch.arrays["reference_s"], touch.arrays["reference_wrench"][:, 2]
    )
    assert abs(seen + pressed(touch.arrays["stream_s"] - 40)).max() < 0.04
    assert abs(touch.arrays["reference_wrench"][:, [0, 1, 3, 4, 5]]).max() < 1e-3


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (csv_text(header="when,fz_N"), "no column of time"),
        (csv_text(header="time_s,fz"), "has no unit"),
        (csv_text(part=slice(0, 320)), "overlap|does not show|nothing happens"),
    ],
)
def test_a_csv_that_does_not_fit_loses_nothing_and_the_right_one_goes_on(log, tmp_path, text, sentence):
    path = tmp_path / "force.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=sentence):
        join(log, path, {}, longest_gap_s=0.3)
    again = LogWriter(tmp_path / "log.h5", {"program": "log"})
    said = []
    record(None, type("Person", (), {"say": lambda self, t: said.append(t)})(), again, "run")
    assert "the stream is there already" in said[0]
    path.write_text(csv_text())
    assert join(again, path, {}, longest_gap_s=0.3).n_touches == 8


def test_a_sensor_without_force_is_joined_by_its_markers():
    t = np.arange(-1, 25, 0.01)
    window = stream(is_blind=True)
    from ruffini.rig.by_log import _activity

    fit = align(np.array([f.stream_s for f in window.frames]), _activity(window), OFFSET_S + t, pressed(t))
    assert fit.offset_s == pytest.approx(OFFSET_S - 40, abs=2e-3)
    with pytest.raises(InputError, match="neither force nor markers"):
        _activity(window._replace(markers=[]))


def train(t, starts, sizes):
    return sum(s * np.clip(np.minimum(t - a, a + 1.4 - t) / 0.3, 0, 1) for a, s in zip(starts, sizes, strict=True))


def test_many_presses_that_are_nearly_alike_outweigh_one_that_is_exactly():
    """The stream's forces are off by up to a fifth, and its first press looks exactly like the log's last."""
    starts = np.array([2.0, 7.0, 10.0, 13.0, 16.0, 19.0, 22.0, 27.0])
    log_n, stream_n = [0.6, 1.1, 0.8, 1.4, 0.5, 1.0, 0.7, 1.2], [0.7, 1.0, 0.95, 1.2, 0.6, 0.85, 0.85, 1.2]
    stream_s, log_s = np.arange(0, 31, 0.1), np.arange(-0.5, 31, 0.1)
    fit = align(40 + stream_s, -train(stream_s, starts, stream_n), OFFSET_S + log_s, train(log_s, starts, log_n))
    assert fit.offset_s == pytest.approx(OFFSET_S - 40, abs=0.01)


def test_presses_that_fit_in_two_ways_are_refused():
    """As like as a metronome's, and the log holds three of eight."""
    t, starts = np.arange(0, 28, 0.05), 2.0 + 3.0 * np.arange(8)
    force = train(t, starts, [1.0] * 8)
    part = (t > 9.5) & (t < 19.5)
    with pytest.raises(InputError, match=r"in two ways, 3\.0 s apart: record again, .* different forces and pauses"):
        align(40 + t, -force, OFFSET_S + t[part], force[part])


def test_a_log_of_another_recording_does_not_show_the_same():
    t = np.arange(0, 28, 0.05)
    of_stream, of_log = train(t, [2.0, 9.0, 12.0, 20.0], [1.0, 0.6, 1.3, 0.9]), np.clip(np.sin(t), 0, None)
    with pytest.raises(InputError, match="the reference does not show what the stream shows"):
        align(40 + t, -of_stream, OFFSET_S + t, of_log)


def test_a_log_of_other_presses_besides_is_placed_right_or_refused():
    """It began after the stream did and ended later: half of the presses are in both."""
    n_placed = 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        starts, sizes = 2 + np.cumsum(rng.uniform(2.4, 2.6, 12)), rng.uniform(0.5, 1.4, 12)
        stream_s, log_s = np.arange(0, starts[7] + 2, 1 / 30), np.arange(starts[4] - 0.6, starts[-1] + 3, 0.01)
        seen = train(stream_s, starts, sizes * rng.normal(1, 0.05, 12))
        with contextlib.suppress(InputError):
            fit = align(40 + stream_s, -seen, OFFSET_S + log_s, train(log_s, starts, sizes))
            assert fit.offset_s == pytest.approx(OFFSET_S - 40, abs=0.2)
            n_placed += 1
    assert n_placed >= 8


def recorded(tmp_path, latest=lambda: None) -> LogWriter:
    """What is kept while a person presses: the stream has a window of before, and one of the presses."""
    before, presses = stream().between(0, 41), stream().between(41, 99)
    log, windows = LogWriter(tmp_path / "log.h5", {"program": "log"}), iter([before, presses])
    watch = SimpleNamespace(take=lambda: next(windows), latest=latest)
    record(watch, SimpleNamespace(confirm=lambda _: None), log, "run")
    return log


def test_a_record_begins_when_the_person_does(tmp_path):
    (chunk,) = recorded(tmp_path).side_file("").glob("*.npz")
    read_window(chunk, window := Window([], [], [], [], [], []))
    assert [f.frame for f in window.frames] == [f.frame for f in stream().between(41, 99).frames]


def test_a_disk_that_is_full_or_a_line_that_is_lost_ends_the_record(tmp_path, monkeypatch):
    def lost():
        raise NoDeviceError("the line was lost")

    def full(path, _):
        raise InputError(f"{path}: no space left")

    with pytest.raises(NoDeviceError, match="the line was lost"):
        recorded(tmp_path / "a", lost)
    assert len(list((tmp_path / "a").rglob("stream-0000.npz"))) == 1, "what came before it is kept"
    monkeypatch.setattr("ruffini.rig.by_log.write_whole", full)
    with pytest.raises(InputError, match="no space left"):
        recorded(tmp_path / "b")


def test_a_touch_with_a_fault_is_left_out_and_named(log, tmp_path):
    path = tmp_path / "force.csv"
    path.write_text(csv_text())
    gap = stream()
    frames = [f for f in gap.frames if not 44.7 < f.stream_s < 45.3]  # in the second press
    for chunk in log.side_file("").glob("*.npz"):
        chunk.unlink()
    log.side_file("stream-0000.npz").write_bytes(packed(gap._replace(frames=frames), "run"))
    joined = join(log, path, {}, longest_gap_s=0.3)
    assert joined.n_touches == 7
    assert "no frame for 0.6" in joined.faults[0]


def test_a_window_is_read_as_it_was_written(tmp_path):
    window, back = stream(), Window([], [], [], [], [], [])
    (tmp_path / "w.npz").write_bytes(packed(window, "abc"))
    assert read_window(tmp_path / "w.npz", back) == "abc"
    assert [len(part) for part in back] == [len(part) for part in window]
    assert back.frames[7].wrench == pytest.approx(window.frames[7].wrench)
    assert back.markers[3].place is None
    assert back.contacts[5].number == 1
    assert back.contacts[5].place == pytest.approx([0.003, -0.002])
