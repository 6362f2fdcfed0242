"""Indenters that are changed: listed in the bench's file, mounted with the tip up, each found where it ends."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from ruffini.boards import find_board
from ruffini.cli.app import app
from ruffini.errors import InputError, RefusedError
from ruffini.estimators.contact_model.task import TASK, check
from ruffini.estimators.fingertip.task import TASK as FINGERTIP
from ruffini.rig import collect as collecting
from ruffini.rig.bench import Bench
from ruffini.rig.contact_surface import PadMovedError
from ruffini.rig.guarded_stage import DryStage, GuardedStage, Limits
from ruffini.rig.holder import UPRIGHT, Holder
from ruffini.rig.log_file import LogWriter, TouchRecord
from ruffini.rig.program import Indent, Item, Span, Tool, plan, setups_left_out
from ruffini.rig.settings import load_rig
from ruffini.rig.stage import Guard, Place

LIMITS = Limits(0.006, 0.006, 0.003, -0.003, 0.002, 20.0, near_m=3e-4)
FLAT, SOFT = Tool("flat", 5e-3, 80.0, "A1"), Tool("sphere", 5e-3, 20.0, "B2")
LONGER_M = 1e-3  # SOFT is, than FLAT
RIG = """schema = 1
[reference]
kind = "text"
port = "/dev/none"
unit = "g"
full_scale_n = 20.0
sigma_n = 0.005
[stage]
kind = "marlin"
port = "/dev/none"
origin_mm = [0.0, 0.0, 10.0]
[limits]
half_x_mm = 10.0
half_y_mm = 10.0
top_mm = 3.0
bottom_mm = -3.0
deepest_mm = 2.0
near_mm = 0.3
max_force_n = 6.0
"""
INDENTERS = [
    ("A1", "flat", 9, 30), ("A2", "square", 11, 60), ("A3", "flat", 11, 30), ("A4", "flat", 9, 60),
    ("B1", "sphere", 10, 30), ("B2", "sphere", 11, 80), ("B3", "sphere", 11, 30), ("B4", "sphere", 10, 80),
]  # fmt: skip


def listed(rows: list[tuple[str, str, float, float]]) -> str:
    return "".join(
        f'[[indenters]]\nname = "{name}"\nshape = "{shape}"\nsize_mm = {size:.1f}\nshore_a = {shore:.1f}\n'
        for name, shape, size, shore in rows
    )


class Reference:
    """At rest whenever it is tared."""

    def __init__(self) -> None:
        self.n_tared = 0

    def tare(self, duration_s: float = 1.0) -> None:
        self.n_tared += 1

    def tare_change(self, duration_s: float) -> np.ndarray:
        self.n_tared += 1
        return np.zeros(6)


class QuietBench(Bench):
    """Without stream."""

    def hold(self, started_s: float, least_s: float = 0.0) -> float:
        return started_s

    def rest(self) -> list[Any]:
        return []


class Pressed:
    """A stage over a pad, and a person who mounts what they are told: SOFT ends lower."""

    def __init__(self, *, is_there: bool = True) -> None:
        self.dry, self.is_there = DryStage(Place(0.0, 0.0, LIMITS.top_m)), is_there
        self.pad_m, self.after = 0.0, lambda: None
        self.length_m, self.told, self.heights = 0.0, list[str](), list[float]()
        self.reference = Reference()
        stage = GuardedStage(self.dry, Place(0.0, 0.0, 0.0), LIMITS, self.force)
        self.bench: Any = QuietBench(self.reference, None, {}, self, 20.0, stage)  # type: ignore[arg-type]

    def force(self) -> np.ndarray:
        return np.array([0.0, 0.0, -1.0 * (self.dry.position().z_m - self.length_m < self.pad_m - 1e-9)])

    def say(self, text: str) -> None:
        self.told.append(text)

    def confirm(self, text: str) -> None:
        self.say(text)
        self.heights.append(self.dry.position().z_m)
        if not self.is_there:
            raise RefusedError("nobody answers")
        self.length_m = LONGER_M if "B2" in text else 0.0

    def collect(self, items: list[Item], log: LogWriter) -> dict[int, TouchRecord]:
        collecting.collect(self.bench, items, log)
        return log.touches()


@pytest.fixture
def pressed(monkeypatch: pytest.MonkeyPatch) -> Pressed:
    """Its touches are kept as the machine made them: reference, stream and their checks have tests of their own."""
    one = Pressed()

    def perform(bench: Bench, item: Indent) -> tuple[TouchRecord, list[str]]:
        path: list[tuple[float, Place]] = []
        facts = collecting._by_indenter(bench, item, path)
        one.after()
        arrays = {"stage_place": np.array([place for _, place in path]), "reference_wrench": np.zeros((1, 6))}
        return TouchRecord({"told": item.told(), **facts}, arrays), []

    monkeypatch.setattr(collecting, "perform", perform)
    monkeypatch.setattr(collecting, "preflight", lambda bench, _: bench.stage.approach(0.0, 0.0) and {})
    monkeypatch.setattr(collecting, "finish", lambda *_: None)
    return one


def test_each_is_mounted_once_with_the_tip_up_and_found_where_it_ends(pressed: Pressed, tmp_path: Path) -> None:
    items: list[Item] = [Indent(tool, x, 0.0, 1e-3) for tool in (FLAT, SOFT) for x in (1e-3, -1e-3)]
    kept = pressed.collect(items, LogWriter(tmp_path / "log.h5", {}))
    assert [text.partition(",")[0] for text in pressed.told] == [
        "mount indenter A1 (flat of 10.0 mm", "mount indenter B2 (sphere of 10.0 mm",
    ]  # fmt: skip
    assert min(pressed.heights) > LIMITS.top_m - 2 * LONGER_M
    assert pressed.reference.n_tared > 2  # again after each change: the indenter may hang on it
    for number, record in kept.items():
        assert record.facts["tool"] == items[number].tool._asdict()  # type: ignore[union-attr]
        assert record.facts["held_host_s"] == record.facts["touched_host_s"]  # all of the way down counts
        assert np.ptp(record.arrays["stage_place"][:, 2]) == pytest.approx(1e-3)
        assert abs(record.facts["contact_z_m"]) < 2.1e-4


def test_a_longer_tip_comes_down_slowly_and_a_pad_that_moves_is_found_before_the_next_change(
    pressed: Pressed, tmp_path: Path
) -> None:
    stage = pressed.bench.stage
    pressed.bench.put_on(FLAT)
    stage.approach(0.0, 0.0)
    n_moves = len(pressed.dry.moves)
    assert pressed.bench.put_on(SOFT)
    stage.approach(0.0, 0.0)
    way = [move.z_m for move in pressed.dry.moves[n_moves:]]
    assert min(np.diff(way)) > -2.1e-4  # a move down to near_mm would have gone a millimetre into the pad
    assert not pressed.bench.put_on(SOFT)
    pressed.after = lambda: setattr(pressed, "pad_m", -5e-4)
    log = LogWriter(tmp_path / "log.h5", {})
    with pytest.raises(PadMovedError):
        pressed.collect([Indent(tool, 1e-3, 0.0, 1e-3) for tool in (SOFT, FLAT)], log)
    assert log.done() == set()


def test_a_collection_that_nobody_answers_stops_and_goes_on_with_what_is_left(pressed: Pressed, tmp_path: Path) -> None:
    items: list[Item] = [Indent(tool, 1e-3, 0.0, 1e-3) for tool in (FLAT, SOFT)]
    say = pressed.say

    def leave(text: str) -> None:
        say(text)
        pressed.is_there = "B2" not in text

    pressed.say = leave  # type: ignore[method-assign]
    log = LogWriter(tmp_path / "log.h5", {})
    with pytest.raises(RefusedError, match="nobody"):
        pressed.collect(items, log)
    assert log.done() == {0}
    pressed.say, pressed.is_there = say, True  # type: ignore[method-assign]
    assert set(pressed.collect(items, log)) == {0, 1}
    assert [("A1" in text, "B2" in text) for text in pressed.told] == [(True, False), (False, True), (False, True)]


def test_the_plan_mounts_each_listed_indenter_once(tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text(RIG + listed(INDENTERS))
    board = find_board("contact-glitter")
    span = load_rig(tmp_path / "rig.toml").with_tools(TASK.span(board, 1.7e-3, 0.0, None), board)
    tools = span.tools
    assert tools[1] == Tool("square", 5.5e-3, 60.0, "A2")
    check(span)
    fitted, judged = TASK.fitted(span, 18, 2), TASK.judged(span, 6, 1001)
    for items, n, mounted in ((fitted, 18, "A1 A2 A3 A4 B1 B2 B3 B4"), (judged, 6, "A1 A2 A3 B1 B2 B3")):
        names = [item.tool.name for item in items if isinstance(item, Indent)]
        assert len(names) == n
        assert list(dict.fromkeys(names)) == mounted.split()
        assert names == sorted(names)
    assert not {(i.x_m, i.y_m) for i in fitted if isinstance(i, Indent)} & {
        (i.x_m, i.y_m) for i in judged if isinstance(i, Indent)
    }
    drawn = plan("indenters", Span(2e-3, 2e-3, 1e-3, 0.0), 6, 1)
    assert len({item.tool for item in drawn if isinstance(item, Indent)}) == 6


def test_a_rigid_one_needs_no_hardness(tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text(RIG + '[[indenters]]\nname = "S"\nshape = "flat"\nsize_mm = 8.0\n')
    settings = load_rig(tmp_path / "rig.toml")
    (tool,) = settings.with_tools(Span(1e-3, 1e-3, 1e-3, 0.0), find_board("contact-glitter")).tools
    assert tool.shore_a == 98


@pytest.mark.parametrize(("rows", "said"), [
    ([], "list those of this bench"),
    ([*INDENTERS, ("A2", "flat", 8, 20)], "two .* named 'A2'"),
    ([row for row in INDENTERS if row[0] != "A2"], "flat faces of 2 shapes"),
    (INDENTERS[:4], "balls"),
    ([row for row in INDENTERS if row[0] != "A3"],
     r"of A1 \(flat of 9\.0 mm, Shore A 30\) .* flat faces of other sizes and two hardnesses, Shore A 46 or softer"),
    ([row for row in INDENTERS if row[0] != "B4"], "B2 .* list balls of other sizes"),
    ([(*row[:3], 30) for row in INDENTERS], "3 hardnesses"),
    ([*INDENTERS, ("C", "star", 8, 20)], r"indenters\.8\.shape"),
])  # fmt: skip
def test_a_bench_without_the_indenters_is_refused_in_one_sentence_before_anything_moves(
    rows: list[tuple[str, str, float, float]], said: str, tmp_path: Path
) -> None:
    (tmp_path / "rig.toml").write_text(RIG + listed(rows))
    words = ["--board", "contact-glitter", "--rig", str(tmp_path / "rig.toml")]
    for verb in (["collect", "--out", str(tmp_path / "log.h5"), "--dry-run"], ["auto", "--out", str(tmp_path / "a")]):
        with pytest.raises(InputError, match=said):
            raise CliRunner().invoke(app, ["cal", *verb, *words]).exception or AssertionError


def test_the_twins_bench_has_indenters_for_a_contact_model_alone(tmp_path: Path) -> None:
    words = ["cal", "collect", "--rig", "sim", "--out", str(tmp_path / "log.h5"), "--program", "indenters", "--dry-run"]
    assert CliRunner().invoke(app, [*words, "--board", "contact-glitter"]).exit_code == 0
    with pytest.raises(InputError, match="no indenters for board 'stereo-fingertip'"):
        raise CliRunner().invoke(app, [*words, "--board", "stereo-fingertip"]).exception or AssertionError


def test_a_dry_run_prints_every_move_of_every_indenter(tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text(RIG + listed(INDENTERS))
    words = ["--board", "contact-glitter", "--rig", str(tmp_path / "rig.toml"), "--out", str(tmp_path / "log.h5")]
    done = CliRunner().invoke(app, ["cal", "collect", *words, "--n", "8", "--dry-run", "--json"])
    assert done.exit_code == 0, done.exception
    told = json.loads(done.stdout)
    assert (told["program"], told["touches"]) == ("indenters", 8)
    lowest = [z for z in np.array(told["moves_m"])[:, 2] if z < -1.6e-3]
    assert len(lowest) >= 8


def test_a_holder_is_turned_between_presses_and_the_tip_follows_the_middle_of_the_fingertip(
    pressed: Pressed, tmp_path: Path
) -> None:
    pressed.bench.holder = Holder(8e-3)
    items: list[Item] = [Indent(FLAT, 1e-3, 0.0, 1e-3, tilt_deg=tilt) for tilt in (UPRIGHT, (0.0, -20.0), (15.0, 0.0))]
    kept = pressed.collect(items, LogWriter(tmp_path / "log.h5", {}))
    assert pressed.told == [
        "mount indenter A1 (flat of 10.0 mm, Shore A 80), turn the holder to outer axis +0, inner axis +0 degrees, "
        "and take your hands off",
        "turn the holder to outer axis +0, inner axis +20 degrees, and take your hands off",
        "turn the holder to outer axis -15, inner axis +0 degrees, and take your hands off",
    ]
    lowest = [move for move in pressed.dry.moves if move.z_m < -1.1e-3]
    # The middle of the sphere goes round the point below it, and each press is 1 mm beside it.
    aside = [(0.0, 0.0), (8e-3 * np.sin(np.deg2rad(20)), 0.0), (0.0, 8e-3 * np.sin(np.deg2rad(15)))]
    places = sorted({(round(m.x_m, 7), round(m.y_m, 7)) for m in lowest})
    assert places == sorted((round(1e-3 + x, 7), round(y, 7)) for x, y in aside)
    assert [record.arrays["stage_place"][-1, 0] for record in kept.values()] == pytest.approx([1e-3] * 3)


def test_hands_that_stay_on_the_bench_are_asked_off_again(pressed: Pressed) -> None:
    tare_change = pressed.reference.tare_change

    def unsteady(duration_s: float) -> np.ndarray:
        raise RefusedError("the reference is not steady")

    pressed.reference.tare_change = unsteady  # type: ignore[method-assign]
    with pytest.raises(RefusedError, match="not steady"):
        pressed.bench.put_on(FLAT)
    pressed.reference.tare_change = tare_change  # type: ignore[method-assign]
    assert pressed.bench.put_on(FLAT)
    assert len(pressed.told) == 2
    assert not pressed.bench.put_on(FLAT)


def test_the_guards_watch_a_turn(pressed: Pressed) -> None:
    pressed.bench.holder = Holder(0.0, ("A", "-B"))
    watched = list[bool]()

    def turn(degrees: dict[str, float], guard: Guard) -> None:
        pressed.length_m = 10.0  # something presses
        watched.append(True)
        guard()

    pressed.dry.turn = turn  # type: ignore[method-assign, assignment]
    pressed.bench.stage = GuardedStage(pressed.dry, Place(0.0, 0.0, 0.0), LIMITS, lambda: 30 * pressed.force())
    with pytest.raises(RefusedError, match=r"the reference measures 30\.00 N"):
        pressed.bench.put_on(FLAT, (15.0, 0.0))
    assert watched == [True]


def test_a_five_axis_stage_turns_by_itself(pressed: Pressed, tmp_path: Path) -> None:
    pressed.bench.holder = Holder(0.0, ("A", "-B"))
    items: list[Item] = [Indent(FLAT, 1e-3, 0.0, 1e-3, tilt_deg=tilt) for tilt in (UPRIGHT, (15.0, -20.0))]
    pressed.collect(items, LogWriter(tmp_path / "log.h5", {}))
    assert pressed.told == ["mount indenter A1 (flat of 10.0 mm, Shore A 80), and take your hands off"]
    assert pressed.dry.turned == {"A": -15.0, "B": -20.0}


def test_the_plan_turns_the_holder_more_often_than_it_changes_tools(tmp_path: Path) -> None:
    holder = "[holder]\ntilts_deg = [[0.0, 0.0], [20.0, 0.0], [0.0, -30.0]]\npivot_mm = 30.0\n"
    (tmp_path / "rig.toml").write_text(RIG + listed(INDENTERS[:2]) + holder)
    settings, board = load_rig(tmp_path / "rig.toml"), find_board("stereo-fingertip")
    assert settings.holder is not None
    assert settings.holder.of(board) == Holder(pytest.approx(8e-3))
    span = settings.with_tools(FINGERTIP.span(board, 1.6e-3, 0.0, None), board)
    FINGERTIP.check(span)
    assert setups_left_out(span, 6) == ""
    assert setups_left_out(span, 5) == ("5 touches are for 5 of 6 setups (2 indenters, each at all tilts): give --n 6")
    items = [item for item in FINGERTIP.fitted(span, 12, 1) if isinstance(item, Indent)]
    setups = list(dict.fromkeys((item.tool.name, item.tilt_deg) for item in items))
    assert setups == [(name, tilt) for name in ("A1", "A2") for tilt in ((0, 0), (20, 0), (0, -30))]
    assert [(item.tool.name, item.tilt_deg) for item in items] == [setup for setup in setups for _ in range(2)]
    assert json.loads(json.dumps(span.facts)) == span.facts  # a log that is gone on with compares them
    with pytest.raises(InputError, match=r"take \[holder\] out"):
        check(span)


def test_a_fingertip_that_may_come_up_to_the_tool_as_it_turns_is_refused(tmp_path: Path) -> None:
    board, plain = find_board("stereo-fingertip"), Span(1e-3, 1e-3, 1e-3, 0.0)
    holder = "[holder]\ntilts_deg = [[0.0, 0.0], [40.0, 40.0], [-20.0, 0.0]]\npivot_mm = 30.0\n"
    (tmp_path / "rig.toml").write_text(RIG + listed(INDENTERS[:2]) + holder)
    rise_mm = 8 * (1 - np.cos(np.deg2rad(40)) ** 2)
    with pytest.raises(InputError, match=rf"top_mm is 3: .* comes up by {rise_mm:.1f} mm .* give {rise_mm + 1:.1f} mm"):
        load_rig(tmp_path / "rig.toml").with_tools(plain, board)
    (tmp_path / "rig.toml").write_text((tmp_path / "rig.toml").read_text().replace("top_mm = 3.0", "top_mm = 4.5"))
    assert len(load_rig(tmp_path / "rig.toml").with_tools(plain, board).tilts_deg) == 3


@pytest.mark.parametrize("tilts", ["[[0.0, 0.0], [20.0, 0.0]]", "[[20.0, 20.0]]"])
def test_a_fingertip_that_is_not_turned_about_both_axes_and_pressed_upright_is_refused(
    tilts: str, tmp_path: Path
) -> None:
    (tmp_path / "rig.toml").write_text(f"{RIG}{listed(INDENTERS[:2])}[holder]\ntilts_deg = {tilts}\n")
    words = ["--board", "stereo-fingertip", "--rig", str(tmp_path / "rig.toml")]
    for verb in (["collect", "--out", str(tmp_path / "log.h5"), "--dry-run"], ["auto", "--out", str(tmp_path / "a")]):
        with pytest.raises(InputError, match="pressed upright and turned about both axes"):
            raise CliRunner().invoke(app, ["cal", *verb, *words]).exception or AssertionError
