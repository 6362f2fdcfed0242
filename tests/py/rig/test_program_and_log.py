"""Plans, the quality check on a touch, the log file, and the bench's file."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from ruffini.boards import find_board
from ruffini.errors import InputError, RefusedError
from ruffini.rig.collect import rehearse
from ruffini.rig.guarded_stage import Limits
from ruffini.rig.log_file import LogWriter, TouchRecord, read_log
from ruffini.rig.program import Span, plan, span_of
from ruffini.rig.settings import load_rig
from ruffini.rig.stage import Rotary
from ruffini.rig.touch import faults_of

SPAN = Span(0.006, 0.004, 0.001, 0.0003)
LIMITS = Limits(0.008, 0.006, 0.003, -0.0025, 0.001, 5.0)
RIG = """schema = 1
[reference]
kind = "text"
port = "/dev/none"
unit = "g"
full_scale_n = 20.0
sigma_n = 0.005
[stage]
kind = "grbl"
port = "/dev/none"
origin_mm = [110.0, 95.0, 42.0]
[limits]
half_x_mm = 8.0
half_y_mm = 6.0
top_mm = 3.0
bottom_mm = -1.5
deepest_mm = 1.2
max_force_n = 6.0
"""


@pytest.mark.parametrize("program", ["grid", "balls"])
@pytest.mark.parametrize("n", [1, 7, 50])
def test_plan_covers_the_pad_and_is_the_same_each_time(program, n):
    touches = plan(program, SPAN, n, seed=3)
    assert touches == plan(program, SPAN, n, seed=3)
    assert len(touches) == n
    x, y, depth, *shear = np.array(touches).T
    assert abs(x).max() <= SPAN.half_x_m
    assert abs(y).max() <= SPAN.half_y_m
    assert 0.4e-3 - 1e-12 <= depth.min() <= depth.max() <= 1e-3 + 1e-12
    assert np.hypot(*shear).max() == pytest.approx(SPAN.shear_m if program == "grid" and n > 1 else 0)
    if n == 50:
        quarters = {(a > 0, b > 0) for a, b in zip(x, y, strict=True)}
        assert len(quarters) == 4


def test_plan_that_makes_no_sense():
    with pytest.raises(InputError, match="choose one of grid, balls"):
        plan("spiral", SPAN, 5, 1)


def test_span_stays_inside_what_the_camera_sees():
    board = find_board("gelslim")
    span = span_of(board, 1e-3, 0)
    assert 0 < span.half_x_m * 1e6 < board.window.max_x_um - board.pad.size_x_um / 2
    assert 0 < span.half_y_m * 1e6 < board.window.max_y_um - board.pad.size_y_um / 2


def test_span_stays_a_pads_thickness_from_a_window_that_ends_inside_the_pad():
    """On the twin of gelsight-mini a press 2.4 mm from the window's border was told as 0.07 N of 0.73 N."""
    mini = find_board("gelsight-mini")
    span = span_of(mini, 1e-3, 0)
    assert (span.half_x_m, span.half_y_m) == pytest.approx((10.144e-3 - 4e-3, 7.608e-3 - 4e-3))
    gelslim = find_board("gelslim")  # its camera sees all of the pad
    assert span_of(gelslim, 1e-3, 0).half_y_m == pytest.approx(0.75 * 8e-3)


def test_rehearsal_takes_the_real_moves_and_finds_what_is_out():
    touches = plan("grid", SPAN, 6, 1)
    rehearsal = rehearse(touches, LIMITS)
    assert rehearsal.least_s > 6 * (0.8 + 2 * 3e-3 / 0.010 + 0.0004 / 0.001)
    with pytest.raises(RefusedError, match="beside the pad"):
        rehearse([touches[0]._replace(shear_x_m=0.02)], LIMITS)
    with pytest.raises(RefusedError, match=r"a depth of 1\.5 mm"):
        rehearse([touches[0]._replace(depth_m=0.0015)], LIMITS)


def good() -> tuple[dict, dict]:
    """A touch held from 1 s to 2 s with 1 N."""
    t = np.arange(0, 3, 0.02)
    force = np.where((t > 0.8) & (t < 2.1), -1.0, 0.0)
    wrench = np.column_stack([0 * t, 0 * t, force, 0 * t, 0 * t, 0 * t])
    arrays = {
        "stream_s": t, "stream_host_s": t + 100, "stream_frame": np.arange(len(t)),
        "stream_flags": np.zeros(len(t), int), "stream_wrench": wrench, "stream_validity": np.ones((len(t), 6), int),
        "reference_s": t + 100, "reference_wrench": wrench.copy(), "stage_s": t[:3] + 100,
        "stage_place": np.zeros((3, 3)),
    }  # fmt: skip
    return arrays, {"held_host_s": 101.0, "lifted_host_s": 102.0, "x_m": 0.001}


def test_good_touch_passes():
    assert faults_of(*good(), {1: "dark"}) == []


def test_each_fault_of_a_touch_is_named():
    def fault(change) -> list[str]:
        arrays, facts = good()
        change(arrays)
        return faults_of(arrays, facts, {1: "dark"})

    def put(name, rows, value):
        return lambda a: a[name].__setitem__(rows, value)

    def lose(prefix, low, high):
        def change(a):
            keep = (a["stream_s"] < low) | (a["stream_s"] > high)
            a.update({k: v[keep] for k, v in a.items() if k.startswith(prefix)})

        return change

    assert fault(put("stream_flags", 70, 1)) == ["dark"]
    assert fault(put("stream_flags", 5, 1)) == []  # before the hold
    assert fault(lose("stream", 0.1, 0.6))[0].startswith("no frame for 0.5")
    assert fault(lose("stream", 1.02, 1.99))[0].startswith("0 frames while it was held")
    assert fault(lose("reference", 1.02, 1.99))[0].startswith("0 readings of the reference")
    assert fault(put("stream_wrench", np.s_[:, 2], -0.05))[0].startswith("the sensor saw 0.050 N of 1.000 N")
    assert fault(put("stream_wrench", np.s_[:], np.nan)) == []

    def sideways(a):  # no colours yet: the markers tell the shear of a press, and hardly any
        a["reference_wrench"][50:100, 0] = 0.07
        a["stream_wrench"][:, 2] = np.nan

    assert fault(sideways) == []
    assert fault(put("reference_wrench", np.s_[:, 2], 0.0)) == ["the reference saw only 0.000 N"]
    twist, facts = good()
    twist["reference_wrench"][:] = 0
    twist["reference_wrench"][50:100, 5] = 0.01
    assert faults_of(twist, {**facts, "kind": "condition"}, {}) == []
    assert fault(put("reference_wrench", np.s_[110:, 2], -0.06))[0].startswith("0.060 N stayed")


def test_log_is_written_whole_gone_on_with_and_read_back(tmp_path):
    path = tmp_path / "log.h5"
    arrays, facts = good()
    writer = LogWriter(path, {"board": "x"})
    writer.write(2, TouchRecord({**facts, "x_m": 2.0}, arrays))
    writer.write(0, TouchRecord(facts, arrays))
    assert LogWriter(path, {"board": "x"}).done() == {0, 2}
    assert not path.exists()
    with pytest.raises(InputError, match="begun with another board"):
        LogWriter(path, {"board": "y"})
    LogWriter(path, {"board": "x"}).finish()
    log = read_log(path)
    assert log.facts == {"board": "x"}
    assert [t.facts["x_m"] for t in log.touches] == [0.001, 2.0]
    assert np.array_equal(log.touches[1].arrays["reference_wrench"], arrays["reference_wrench"])
    assert list(tmp_path.iterdir()) == [path]
    with h5py.File(path) as file:
        assert file["touch/00000/stage_place"].attrs["unit"] == "m"


def test_two_programs_do_not_collect_into_one_log(tmp_path: Path) -> None:
    first, second = LogWriter(tmp_path / "log.h5", {}), LogWriter(tmp_path / "log.h5", {})
    with first.locked(), pytest.raises(InputError, match="another program collects into it now"), second.locked():
        pass
    with first.locked():
        first.finish()
    with pytest.raises(InputError, match="another program has completed it"), second.locked():
        pass


@pytest.mark.parametrize("text", ["", "spoilt", "[]", "[" * 100_000])
def test_spoilt_files_of_a_log_that_was_begun_are_named(text: str, tmp_path: Path) -> None:
    path = tmp_path / "log.h5"
    writer = LogWriter(path, {})
    begun, touch = tmp_path / "log.h5.parts" / "log.json", tmp_path / "log.h5.parts" / "00000.h5"
    touch.write_text(text)
    with pytest.raises(InputError, match=rf"{touch}: cannot be read .*: remove it, and it is collected again"):
        writer.touches()
    begun.write_text(text)
    with pytest.raises(InputError, match=rf"{begun}: cannot be read .*: begin a new log in another place"):
        LogWriter(path, {})


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda a: a.pop("stream_s"), "lacks stream_s"),
        (lambda a: a.update(reference_wrench=a["reference_wrench"][:, :3]), "reference_wrench is"),
        (lambda a: a.update(stream_s=a["stream_s"] * 0), "stream_s stands still"),
        (lambda a: a["reference_s"].__setitem__(3, np.nan), "reference_s stands still"),
    ],
)
def test_log_from_elsewhere_that_is_wrong(tmp_path, change, sentence):
    arrays, facts = good()
    change(arrays)
    writer = LogWriter(tmp_path / "log.h5", {})
    writer.write(0, TouchRecord(facts, arrays))
    writer.finish()
    with pytest.raises(InputError, match=sentence):
        read_log(tmp_path / "log.h5")


def test_no_log(tmp_path):
    path = tmp_path / "log.h5"
    path.write_bytes(b"no HDF5")
    with pytest.raises(InputError, match="cannot be read"):
        read_log(path)
    with h5py.File(path, "w"):
        pass
    with pytest.raises(InputError, match="is no ruffini-calibration-log"):
        read_log(path)


def test_bench_file(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text(RIG)
    rig = load_rig(path)
    assert rig.stage.origin(find_board("gelslim")) == pytest.approx((0.11, 0.095, 0.042))
    assert rig.limits.limits == Limits(0.008, 0.006, 0.003, -0.0015, 0.0012, 6.0)
    for old, new, sentence in [
        ("max_force_n = 6.0", "", "limits.max_force_n"),
        ('kind = "grbl"', 'kind = "robot"', "stage.kind"),
        ("sigma_n", "sigmma_n", "reference.text.sigm"),
        ("bottom_mm = -1.5", "bottom_mm = 1.5", "limits.bottom_mm"),
        ("schema = 1", "schema = ", "cannot be read"),
    ]:
        path.write_text(RIG.replace(old, new))
        with pytest.raises(InputError, match=sentence):
            load_rig(path)


def test_a_tube_wants_an_axis_that_turns_it_and_a_flat_pad_none(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text(RIG)
    straight = load_rig(path).stage
    path.write_text(RIG.replace("[limits]", 'rotary_axis = "A"\nrotary_origin_deg = 90.0\n[limits]'))
    turning = load_rig(path).stage
    flat, tube = find_board("gelslim"), find_board("eltac")
    assert straight.rotary(flat) is None
    for stage, board, sentence in ((straight, tube, "is a tube, and this stage"), (turning, flat, "is no tube")):
        with pytest.raises(InputError, match=sentence):
            stage.open(board)
    radius_m = 1e-6 * tube.skin.radius_um
    assert turning.rotary(tube) == Rotary("A", radius_m, 0.11)
    assert turning.origin(tube) == pytest.approx((radius_m * np.pi / 2, 0.095, 0.042))
