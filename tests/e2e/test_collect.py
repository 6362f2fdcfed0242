"""A whole bench without hardware: real daemon on a pty, G-code machine on a pty, force/torque over UDP, the twin."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from test_live_twin import Twin, connected, twin  # noqa: F401

from ruffini.errors import InputError, RefusedError
from ruffini.rig.clock import fit_clock
from ruffini.rig.collect import Bench, Progress, collect
from ruffini.rig.emulated_dialects import EmulatedMarlin
from ruffini.rig.guarded_stage import GuardedStage, Limits, force_guard
from ruffini.rig.log_file import LogWriter, read_log
from ruffini.rig.marlin import Marlin
from ruffini.rig.network_cell import NetworkCell
from ruffini.rig.program import Span, Touch, plan
from ruffini.rig.stream_watch import StreamWatch
from ruffini.rig.twin_bench import FULL_SCALE, ORIGIN, SIGMA, build_twin_bench
from ruffini.rig.watch import Watch
from ruffini.sim.contact import Indenter

FACTS = {"board": "tiny", "program": "grid", "seed": 1}
LIMITS = Limits(0.006, 0.005, 0.002, -0.0015, 0.001, 5.0)
PLAN = plan("grid", Span(0.003, 0.002, 0.0006, 0.0002), 4, seed=1)
NO_REFERENCE, DARK = 1, 64


@contextlib.contextmanager
def bench(twin: Twin, folder: Path) -> Iterator[Bench]:  # noqa: F811
    with contextlib.ExitStack() as stack:
        machine = stack.enter_context(EmulatedMarlin())
        parts = build_twin_bench(twin.unit, Indenter("sphere", 0.003), machine, folder / "twin", seed=1)
        stack.enter_context(parts.server)
        cell = stack.enter_context(parts.cell)
        stream = stack.enter_context(StreamWatch(stack.enter_context(connected(twin, folder))))
        reference = stack.enter_context(
            Watch(NetworkCell("127.0.0.1", FULL_SCALE, SIGMA, settings=cell.settings, port=cell.port))
        )
        stage = Marlin(machine.port)
        stack.callback(stage.close)
        stage.home()
        stream.wait_for_rest(NO_REFERENCE)
        reference.tare(0.3)
        guard = force_guard("the sensor", stream.force, 8.0)
        rig = GuardedStage(stage, ORIGIN, LIMITS, lambda: reference.latest().wrench, [guard],
                           fresh_force_of=lambda: reference.fresh().wrench)  # fmt: skip
        yield Bench(rig, reference, stream, {NO_REFERENCE: "rest not learned", DARK: "dark"})


def test_touches_are_collected_kept_and_gone_on_with(twin: Twin, tmp_path: Path) -> None:  # noqa: F811
    told: list[Progress] = []
    out = tmp_path / "log.h5"
    with bench(twin, tmp_path) as b:
        beside = [*PLAN[:2], Touch(0.05, 0, 0.0005)]
        with pytest.raises(RefusedError, match="beside the pad"):
            collect(b, beside, LogWriter(out, FACTS))
        assert LogWriter(out, FACTS).done() == {0, 1}
        with pytest.raises(InputError, match="begun with another seed"):
            LogWriter(out, {**FACTS, "seed": 2})
        collect(b, PLAN, LogWriter(out, FACTS), tell=told.append)
    assert [p.n_done for p in told] == [3, 4]
    assert told[-1].remaining_s == 0
    log = read_log(out)
    assert log.facts == FACTS
    assert len(log.touches) == 4
    with pytest.raises(InputError, match="exists and is complete"):
        LogWriter(out, FACTS)
    for touch, wanted in zip(log.touches, PLAN, strict=True):
        a, f = touch.arrays, touch.facts
        assert (f["x_m"], f["depth_m"]) == (wanted.x_m, wanted.depth_m)
        held = (a["reference_s"] > f["held_host_s"]) & (a["reference_s"] < f["lifted_host_s"])
        truth = a["reference_wrench"][held].mean(axis=0)
        seen = a["stream_wrench"][(a["stream_host_s"] > f["held_host_s"]) & (a["stream_host_s"] < f["lifted_host_s"])]
        assert truth[2] < -0.09
        assert seen[-5:, 2].mean() == pytest.approx(truth[2], rel=0.3, abs=0.05)
        if wanted.shear_x_m or wanted.shear_y_m:  # the tip pulls the pad along
            assert np.dot(truth[:2], [wanted.shear_x_m, wanted.shear_y_m]) > 0
        assert a["field_displacement"].shape[-1] == 3
        assert a["stage_place"][-1] == pytest.approx(
            [wanted.x_m + wanted.shear_x_m, wanted.y_m + wanted.shear_y_m, f["contact_z_m"] - wanted.depth_m]
        )
    a = [t.arrays for t in log.touches]
    stream_s = np.concatenate([x["stream_s"] for x in a])
    clock = fit_clock(
        stream_s + np.median(np.concatenate([x["stream_host_s"] for x in a]) - stream_s),
        np.concatenate([x["stream_wrench"][:, 2] for x in a]),
        np.concatenate([x["reference_s"] for x in a]), np.concatenate([x["reference_wrench"][:, 2] for x in a]),
    )  # fmt: skip
    assert abs(clock.offset_s) < 0.1  # the camera's pipeline is slower than the reference's
