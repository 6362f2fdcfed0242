"""A whole bench without hardware: real daemon on a pty, G-code machine on a pty, force/torque over UDP, the twin."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_live_twin import Twin, twin  # noqa: F401

from ruffini.demo.twin_session import Simulated, TwinOptions, open_simulated
from ruffini.errors import InputError, RefusedError
from ruffini.rig.bench import Bench
from ruffini.rig.collect import Progress, collect
from ruffini.rig.emulated_references import ASKEW
from ruffini.rig.found import is_held, on_reference_clock, reference_in_pad
from ruffini.rig.guarded_stage import Limits
from ruffini.rig.log_file import LogWriter, read_log
from ruffini.rig.program import Span, Touch, plan
from ruffini.rig.session import ready_bench

FACTS = {"board": "tiny", "program": "grid", "seed": 1}
LIMITS = Limits(0.006, 0.005, 0.002, -0.0015, 0.001, 5.0, near_m=0.0003)
PLAN = plan("grid", Span(0.004, 0.003, 0.0008, 0.0005), 8, seed=1)


@contextlib.contextmanager
def bench(twin: Twin, program: str = "grid", machine: str = "marlin") -> Iterator[tuple[Bench, Simulated]]:  # noqa: F811
    """A bench on the tiny twin, calibrated, homed and at rest."""
    with contextlib.ExitStack() as stack:
        simulated = open_simulated(stack, twin.board, program, TwinOptions(machine), twin.unit)
        simulated.parts.sensor.flash(twin.calibration)
        yield stack.enter_context(ready_bench(simulated.parts, twin.board, LIMITS)), simulated


def test_touches_are_collected_kept_and_gone_on_with(twin: Twin, tmp_path: Path) -> None:  # noqa: F811
    told: list[Progress] = []
    out = tmp_path / "log.h5"
    with bench(twin) as (b, _):
        beside = [*PLAN[:2], Touch(0.05, 0, 0.0005)]
        with pytest.raises(RefusedError, match="beside the pad"):
            collect(b, beside, LogWriter(out, FACTS))
        assert LogWriter(out, FACTS).done() == {0, 1}
        with pytest.raises(InputError, match="begun with another seed"):
            LogWriter(out, {**FACTS, "seed": 2})
        collect(b, PLAN, LogWriter(out, FACTS), tell=told.append)
    assert [p.n_done for p in told] == list(range(3, 9))
    assert told[-1].remaining_s == 0
    log = read_log(out)
    assert log.facts == FACTS
    with pytest.raises(InputError, match="exists and is complete"):
        LogWriter(out, FACTS)
    checks = {name: check["ok"] for name, check in log.found["checks"].items()}
    assert checks == {"rate": True, "tare": True, "axes": True, "unit": True}
    assert "why_not" not in log.found["frame"], log.found
    # What the bench was made with: a reference that stands askew, on one clock with the sensor.
    turn = Rotation.from_matrix(np.array(log.found["frame"]["rotation"]))
    true = Rotation.from_euler("xyz", ASKEW.turn_deg, degrees=True)
    assert np.rad2deg((turn * true.inv()).magnitude()) < 4
    assert log.found["frame"]["arm_m"] == pytest.approx(ASKEW.arm_m, abs=2e-3)
    for touch, wanted in zip(log.touches, PLAN, strict=True):
        a, f = touch.arrays, touch.facts
        assert (f["kind"], f["x_m"], f["depth_m"]) == ("press", wanted.x_m, wanted.depth_m)
        truth = reference_in_pad(log, touch)[is_held(a["reference_s"], f)].mean(axis=0)
        seen = a["stream_wrench"][is_held(a["stream_host_s"], f)]
        assert truth[2] < -0.09
        assert seen[-5:, 2].mean() == pytest.approx(truth[2], rel=0.3, abs=0.05)
        if wanted.shear_x_m or wanted.shear_y_m:  # the tip pulls the pad along
            assert np.dot(truth[:2], [wanted.shear_x_m, wanted.shear_y_m]) > 0
        assert a["field_displacement"].shape[-1] == 3
        assert abs(a["rest_field_displacement"]).max() < 0.2 * abs(a["field_displacement"]).max()
        assert a["marker_displacement"].shape[1:] == (63, 2)
        assert len(a["image"]) >= 2
        assert a["stage_place"][-1] == pytest.approx(
            [wanted.x_m + wanted.shear_x_m, wanted.y_m + wanted.shear_y_m, f["contact_z_m"] - wanted.depth_m]
        )
        assert abs(on_reference_clock(log, touch) - a["stream_host_s"]).max() < 0.5
    assert abs(log.found["clocks"][0]["late_s"]) < 0.2  # the camera's pipeline is slower than the reference's
