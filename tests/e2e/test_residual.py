"""What the forces do not explain: a press leaves little, a fault of the pad stands out where it is. SIMULATED."""

from __future__ import annotations

import contextlib
import itertools
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from browser import colours_in, sensor_of, state_of, viewer, wait_for
from hang import HANG_S
from playwright.sync_api import Page
from tiny_twin import Twin

import ruffini
from ruffini.core import Pipeline
from ruffini.daemon import running_daemon
from ruffini.device import Connection
from ruffini.device.results import VALID
from ruffini.record import record_stream
from ruffini.record.export import export
from ruffini.sim.contact import Indenter, Pose
from ruffini.sim.optics.conditions import Conditions
from ruffini.sim.scenario import Scenario
from ruffini.sim.serve import Steered, TwinServer
from ruffini.wire import Frame, Schema

MM = 1e-3
NUMBER = Schema.own().type_numbers
FAULT_MM, RADIUS_MM, SLID_UM = (-4.0, 3.0), 2.5, 120
PRESS = Pose(3 * MM, -1.5 * MM, 0.6 * MM)
# Of this coarse pad (nodes 1.3 mm apart, markers 2 mm) with the calibration's noise of 5, 5, 20 um: rms of x, y, z.
MOST_UNTOUCHED, MOST_PRESSED, LEAST_FAULT = 4.0, 8.0, 12.0

Array = npt.NDArray[np.float64]


def slid(twin: Twin, displacement: Array) -> Array:
    """A patch of the pad has come loose and slid along x."""
    model, out = twin.unit.model, displacement.copy()
    x, y = (axis.ravel() / MM for axis in np.meshgrid(model.node_x(), model.node_y()))
    out[:, 0] += SLID_UM * 1e-6 * (np.hypot(x - FAULT_MM[0], y - FAULT_MM[1]) < RADIUS_MM)
    return out


def most_of(size: Array, board: ruffini.boards.Board) -> tuple[float, float]:
    """The largest value of a map, and how far from the fault it is, mm."""
    row, column = np.unravel_index(np.argmax(size), size.shape)
    x, y = ((2 * i / (n - 1) - 1) * um * 0.5e-3 for i, n, um in (
        (column, size.shape[1], board.pad.size_x_um), (row, size.shape[0], board.pad.size_y_um)))  # fmt: skip
    return float(size.max()), float(np.hypot(x - FAULT_MM[0], y - FAULT_MM[1]))


def test_a_press_leaves_little_and_a_fault_stands_out_where_it_is(twin: Twin) -> None:
    unit, board, rng = twin.unit, twin.board, np.random.default_rng(1)
    renderer, rig = unit.renderer(), unit.rig()
    rest = rig.displacement.copy()
    rig.take(Indenter("sphere", 3 * MM))
    for step in range(6):
        rig.advance(Pose(PRESS.x_m, PRESS.y_m, PRESS.depth_m * (step + 1) / 6))
    pressed = rig.displacement.copy()
    torn = Conditions(tear_um=(round(1e3 * FAULT_MM[0]), round(1e3 * FAULT_MM[1]), 2000))
    with Pipeline(board, twin.calibration) as pipeline:

        def look(displacement: Array, conditions: Conditions | None = None) -> tuple[float, float]:
            for _ in range(3):
                frame = pipeline.process(renderer.image(displacement, rng, conditions=conditions))
            is_told = conditions is not None  # markers go with the coating; of what slides no flag tells
            assert (frame.force_z_validity == VALID) != is_told
            return most_of(np.sqrt(np.mean((pipeline.residual() / 64.0) ** 2, axis=2)), board)

        for _ in range(board.pipeline.n_rest_frames):
            pipeline.process(renderer.image(rest, rng))
        seen = {
            "untouched": look(rest),
            "pressed": look(pressed),
            "slid": look(slid(twin, rest)),
            "slid, pressed": look(slid(twin, pressed)),
            "torn": look(rest, torn),
            "torn, pressed": look(pressed, torn),
            "pressed again": look(pressed),
        }
    for name, (most, away_mm) in seen.items():
        print(f"{name}: at most {most:.1f} standard deviations, {away_mm:.1f} mm from the fault's middle")
    assert 0.5 < seen["untouched"][0] < MOST_UNTOUCHED
    assert max(seen["pressed"][0], seen["pressed again"][0]) < MOST_PRESSED
    for name in ("slid", "slid, pressed"):
        assert seen[name][0] > LEAST_FAULT
        assert seen[name][1] < RADIUS_MM
    # Depth is an integral of the light's slopes: what shines through a hole is felt over the whole pad.
    assert min(seen["torn"][0], seen["torn, pressed"][0]) > LEAST_FAULT


FREE = 1 << 60  # frames


class Sliding(Steered):
    """A held press on a pad of which a patch slides when it is told to.

    Free-running at first; after the first `allow_one` it waits, and makes one frame for each further call, which comes
    once all results of the frame before have been read.
    """

    def __init__(self, twin: Twin) -> None:
        super().__init__(twin.unit, Indenter("sphere", 3 * MM))
        self._twin, self.has_slid = twin, False
        self._changed, self._requested = threading.Condition(), 0
        self._allowed = FREE

    def allow_one(self) -> int:
        """One more frame after those that were allowed, and then no other; its number."""
        with self._changed:
            self._allowed = min(self._allowed, self._requested) + 1
            self._changed.notify_all()
            return self._allowed

    def run_free(self) -> None:
        with self._changed:
            self._allowed = FREE
            self._changed.notify_all()

    def states(self, frame: int) -> tuple[Array, Array, None]:
        with self._changed:
            self._requested = frame
            self._changed.wait_for(lambda: frame <= self._allowed, HANG_S)
        found = super().states(frame)
        assert found is not None
        now, before = (slid(self._twin, d) if self.has_slid else d for d in found[:2])
        return now, before, None


@contextlib.contextmanager
def sliding(twin: Twin, folder: Path, *options: str) -> Iterator[tuple[str, Sliding]]:
    """A calibrated sensor on a pty with a ball held in its pad."""
    pad = Sliding(twin)
    assert twin.board.folder is not None
    with (
        TwinServer(twin.unit.renderer(), pad, Scenario(), folder / "twin"),
        running_daemon(twin.board.folder, f"twin:{folder / 'twin'}", folder / "store", *options) as port,
    ):
        with Connection(port) as sensor:
            sensor.flash(twin.calibration)
            sensor.subscribe(wrench=1)
            for frame, message in sensor.stream(timeout_s=HANG_S):
                if frame.type == NUMBER["WRENCH"] and message.validity[2] == VALID:  # rest is learned
                    break
        pad.move_to(PRESS)
        try:
            yield port, pad
        finally:
            pad.run_free()


def paced(connection: Connection, pad: Sliding) -> None:
    """From the next turn of a stream on, each frame is made once WRENCH and RESIDUAL, which comes every second time, of
    those before were read: no message is replaced by a newer one, however slow this computer is.
    """
    turn, keep = connection.on_turn, connection.messages.append
    allowed = wrench_at = residual_at = 0

    def begin(is_open: bool) -> None:
        nonlocal allowed
        connection.on_turn = turn
        allowed = pad.allow_one()
        turn(is_open)

    def keep_and_allow(frame: Frame, message: Any) -> None:
        nonlocal allowed, wrench_at, residual_at
        keep(frame, message)
        if frame.type == NUMBER["RESIDUAL"]:
            residual_at = message.stamp.frame
        elif frame.type == NUMBER["WRENCH"]:
            wrench_at = message.stamp.frame
        if wrench_at == allowed and (not residual_at or residual_at >= allowed - 1):
            allowed = pad.allow_one()

    connection.messages.append = keep_and_allow  # type: ignore[method-assign]
    connection.on_turn = begin  # last: another thread may take a turn at once, and what it allows must be heard


def test_it_comes_to_who_asks_and_is_recorded_and_exported(tmp_path: Path, twin: Twin) -> None:
    with sliding(twin, tmp_path, "--lockstep") as (port, pad):  # every frame comes, and none is repeated
        with ruffini.connect(port) as sensor:
            for _, frame in zip(range(8), sensor.frames(), strict=False):
                assert frame.residual is None, "nobody asked"
        pad.allow_one()  # the camera waits until the next host has subscribed
        with ruffini.connect(port, residual=2) as sensor:
            every = sensor.frames()  # subscribes, and only then the camera may go on: else nobody hears of its frame
            paced(sensor._connection, pad)
            asked = itertools.dropwhile(lambda frame: frame.residual is None, every)
            # A frame waits for RESIDUAL once two have told its interval; before, a late one is left out of its frame.
            frames = list(itertools.islice(asked, 4, 16))
        with Connection(port) as host:
            paced(host, pad)
            counts = record_stream(host, tmp_path / "run.mcap", n_frames=20, residual_every=2)
    assert np.diff([frame.number for frame in frames]).tolist() == [1] * 11
    found = {frame.number: frame.residual for frame in frames if frame.residual is not None}
    assert len(found) == 6
    assert np.diff(list(found)).tolist() == [2] * 5
    for residual in found.values():
        assert residual.validity == VALID
        assert residual.residual.shape == (twin.board.grid.n_y, twin.board.grid.n_x, 3)
        assert np.isfinite(residual.size).all()
    recording = ruffini.Recording(tmp_path / "run.mcap")
    replayed = [frame.residual.size for frame in recording.frames(partial=True) if frame.residual is not None]
    assert len(replayed) >= counts["RESIDUAL"] >= 9
    export(recording, tmp_path / "run.npz", "npz")
    with np.load(tmp_path / "run.npz") as table:
        out = table["field_residual"]
    assert out.shape[1:] == (*replayed[0].shape, 3)
    assert np.isfinite(out).all(axis=(1, 2, 3)).sum() == len(replayed) < len(out)


def test_the_page_shows_where_a_patch_has_slid_and_asks_only_while_it_shows_it(
    twin: Twin, page: Page, tmp_path: Path
) -> None:
    def rates(state: dict[str, Any]) -> dict[str, float]:
        return dict(state["lines"][0]["health"]["perS"])

    with sliding(twin, tmp_path) as (port, pad), viewer(port) as address:
        page.goto(address)
        state = wait_for(
            page, "a press", lambda s: sensor_of(s)["wrench"]["values"][2] < -0.2 and rates(s)["FIELD"] > 3
        )
        assert "RESIDUAL" not in rates(state)
        assert sensor_of(state)["maps"]["residual"] == "press E"
        assert not page.is_visible("figure:has(canvas[aria-label='Not explained'])")
        page.keyboard.press("e")
        wait_for(page, "the map", lambda s: sensor_of(s)["maps"]["residual"] == "values")
        # The map on the page may be of a frame in which the ball was on its way.
        state = wait_for(page, "that of a held press", lambda s: sensor_of(s)["residual"]["most"] < MOST_PRESSED)
        assert sensor_of(state)["residual"]["validity"] == VALID
        pad.has_slid = True
        first = sensor_of(wait_for(page, "the slid patch", lambda s: sensor_of(s)["residual"]["most"] > LEAST_FAULT))
        state = wait_for(
            page, "another frame", lambda s: sensor_of(s)["residual"]["frame"] > first["residual"]["frame"]
        )
        assert sensor_of(state)["residual"]["most"] > LEAST_FAULT
        grid = np.zeros((twin.board.grid.n_y, twin.board.grid.n_x))
        grid.ravel()[sensor_of(state)["residual"]["at"]] = 1.0
        assert most_of(grid, twin.board)[1] < RADIUS_MM
        figure = page.locator("figure:has(canvas[aria-label='Not explained'])")
        assert colours_in(page, "canvas[aria-label='Not explained']") > 50
        assert chr(0x3C3) in figure.inner_text()
        page.keyboard.press("e")
        wait_for(page, "it gone", lambda s: not rates(s).get("RESIDUAL"))
        assert sensor_of(state_of(page))["maps"]["residual"] == "press E"
        assert not figure.is_visible()
