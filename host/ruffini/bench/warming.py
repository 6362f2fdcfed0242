"""Lamps that warm up apart for five minutes, a press held meanwhile. SIMULATED.

Each part of a lamp loses light at its own rate from its own place ([[warming]] of twin.toml), so the loss varies over
the picture. The board's own front end and solve follow it frame by frame. Beside them, on frames of the same run: no
correction, and one polynomial per channel fitted offline to that frame's own untouched picture.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate import container
from ruffini.core.pipeline import Frame, Pipeline
from ruffini.errors import InputError
from ruffini.estimators.threshold.fit import fit_contact_noise, linear_pressure
from ruffini.sim.contact import Indenter, Pose
from ruffini.sim.optics.settings import WarmingSettings
from ruffini.sim.settings import TwinSettings, load_twin
from ruffini.sim.surface import wrench_of
from ruffini.sim.unit import TwinUnit
from ruffini.tables import aligned

Array = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint8]
Progress = Callable[[float], None]

# Assumed: a bar of LEDs beside the pad for each colour, whose LEDs warm up unequally, makes an eighth of the colour's
# light. Red falls by 5 % in three minutes. A real sensor's fell by 4.6 %, with less spread over the picture (2 %) but
# more depth made of it (141 um).
_BARS = (  # lamp, place (um), loss (1/1000), time constant (s); an LED has BAR_SHARE_1E3 of its colour's light
    (0, (13_000, -5_000, -6_000), 300, 70), (0, (13_000, 5_000, -6_000), 60, 100),
    (1, (-13_000, -5_000, -6_000), 60, 70), (1, (-13_000, 5_000, -6_000), 250, 60),
    (2, (-8_000, -13_000, -6_000), 500, 50), (2, (0, -13_000, -6_000), 250, 60), (2, (8_000, -13_000, -6_000), 60, 80),
)  # fmt: skip
BAR_SHARE_1E3 = 40
_REST = ((10, 90), (15, 75), (25, 70))  # of the rest of B, G, R: loss, time constant
DURATION_S, HELD_S = 300.0, (100.0, 160.0)  # the press begins and ends
LIGHT_STEP_S = 0.25  # lamps change in steps of this: at most 0.03 % each
JUDGED_EVERY_S = 5.0
SETTLE_S = 10.0  # after the release
PRESS_MM, BALL_MM = 0.6, 4.0
SEED = 20_261_132
LIGHT_FLAG = 1024
N_NOISE = 200  # untouched frames that the noise is measured on
N_AVERAGED = 16  # frames that an offline fit sees
PEERS = (("no correction", None), ("one gain", 0), ("plane", 1), ("quadratic", 2), ("fourth order", 4))


def warming_twin(board: Board) -> TwinSettings:
    """The board's twin with lamps that warm up.

    Raises
    ------
    InputError
        The board has no twin, or its light is not of three coloured lamps.
    """
    twin = load_twin(board)
    if twin.light.kind != "rgb_leds":
        raise InputError(f'board {board.name!r}: the lamps that warm up are those of [light] kind = "rgb_leds"')
    parts = [
        WarmingSettings(lamp=lamp, place_um=list(place), share_1e3=BAR_SHARE_1E3, loss_1e3=loss, time_s=time_s)
        for lamp, place, loss, time_s in _BARS
    ]
    for lamp, (loss, time_s) in enumerate(_REST):
        share = 1000 - BAR_SHARE_1E3 * sum(part.lamp == lamp for part in parts)
        parts.append(WarmingSettings(lamp=lamp, share_1e3=share, loss_1e3=loss, time_s=time_s))
    return twin.model_copy(update={"warming": parts})


class WarmingScene:
    """Frames of one unit whose lamps warm up from time 0 on."""

    def __init__(self, board: Board) -> None:
        self.unit = TwinUnit.build(board, twin=warming_twin(board))
        self.frame_s = self.unit.frame_s
        self._renderer = self.unit.renderer()
        self._rng = np.random.default_rng(SEED)
        solver = self.unit.solver(Indenter("sphere", BALL_MM * 1e-3))
        solver.advance(Pose(1e-3, -1e-3, PRESS_MM * 1e-3))
        self.pressed = solver.displacement
        self.force_n = -float(wrench_of(self.unit.model, solver.nodal_force)[2])

    def frame(self, time_s: float, *, is_pressed: bool = False) -> Picture:
        """The camera's picture at a time."""
        displacement = self.pressed if is_pressed else self.unit.at_rest()
        step = np.floor(time_s / LIGHT_STEP_S) * LIGHT_STEP_S
        return self._renderer.image(displacement, self._rng, time_s=float(step))


def with_noise(board: Board, calibration: bytes, scene: WarmingScene) -> bytes:
    """A calibration with the unit's touch noise, as `cal fit --only threshold` measures it before the lamps warm up."""
    file, n_rest = container.unpack(calibration), board.pipeline.n_rest_frames
    pressure = linear_pressure(board, file, (scene.frame(0.0) for _ in range(N_NOISE + n_rest)))
    noise = fit_contact_noise(pressure, n_rest)
    return container.pack({**file.tensors, **noise.tensors()}, file.metadata).data


def polynomial(shape: tuple[int, int], order: int) -> Array:
    """All products of powers of y and x up to a total order over the picture, (h w, n)."""
    y, x = np.meshgrid(*(np.linspace(-1, 1, n) for n in shape), indexing="ij")
    return np.column_stack([(x**i * y**j).ravel() for i in range(order + 1) for j in range(order + 1 - i)])


def corrected(now: Array, rest: Array, order: int) -> Array:
    """A picture (h, w, 3) over the polynomial of an order that is nearest to its ratio to rest in each channel."""
    basis = polynomial(rest.shape[:2], order)
    out = np.empty_like(now)
    for c in range(3):
        is_used = (rest[..., c] > 32).ravel() & (rest[..., c] < 220).ravel()
        ratio = (now[..., c] / np.maximum(rest[..., c], 1)).ravel()
        fitted = np.linalg.lstsq(basis[is_used], ratio[is_used], rcond=None)[0]
        out[..., c] = now[..., c] / (basis @ fitted).reshape(rest.shape[:2])
    return out


def _learn(pipeline: Pipeline, scene: WarmingScene) -> None:
    while not pipeline.process(scene.frame(0.0)).has_reference:
        pass


def _depth_um(pipeline: Pipeline) -> tuple[float, float]:
    depth = pipeline.depth_m() * 1e6
    return float(np.sqrt((depth**2).mean())), float(np.abs(depth).max())


def _followed(
    board: Board, calibration: bytes, scene: WarmingScene, progress: Progress
) -> tuple[dict[str, Any], dict[str, Any]]:
    """What the board reports of the untouched pad, and of the press."""
    rms, most = [], []
    untouched: dict[str, Any] = {"frames": 0, "false_touches": 0, "flagged": 0, "unflagged_um": 0.0}
    held: list[tuple[float, Frame]] = []
    after_um: list[tuple[float, bool]] = []
    n_frames = round(DURATION_S / scene.frame_s)
    with Pipeline(board, calibration) as pipeline:
        _learn(pipeline, scene)
        for i in range(n_frames):
            time_s = i * scene.frame_s
            is_pressed = HELD_S[0] <= time_s < HELD_S[1]
            result = pipeline.process(scene.frame(time_s, is_pressed=is_pressed))
            is_flagged = bool(result.flags & LIGHT_FLAG)
            if is_pressed:
                held.append((time_s, result))
                continue
            untouched["frames"] += 1
            untouched["false_touches"] += int(result.n_contacts > 0 and not is_flagged)
            untouched["flagged"] += int(is_flagged)
            if i % 15 == 0:
                now_um, most_um = _depth_um(pipeline)
                if not is_flagged:
                    untouched["unflagged_um"] = max(untouched["unflagged_um"], now_um)
                if HELD_S[1] <= time_s < HELD_S[1] + SETTLE_S:
                    after_um.append((now_um, is_flagged))
                else:
                    rms.append(now_um)
                    most.append(most_um)
            if i % 100 == 0:
                progress(i / n_frames)
    error = np.array([-f.wrench[2] for _, f in held]) - scene.force_n
    is_flagged_then = np.array([bool(f.flags & LIGHT_FLAG) for _, f in held])
    second = round(1 / scene.frame_s)
    press = {
        "force_n": scene.force_n, "first_error_n": float(error[second // 4 : second].mean()),
        "last_error_n": float(error[-second:].mean()), "flagged": float(is_flagged_then.mean()),
        "worst_unflagged_n": float(np.abs(error[~is_flagged_then]).max(initial=0.0)),
        "after_um": max(um for um, _ in after_um), "after_flagged": float(np.mean([f for _, f in after_um])),
    }  # fmt: skip
    row = {"name": "board", "rms_um": max(rms), "max_um": max(most), **untouched}
    return row, press


def _peers(board: Board, calibration: bytes, scene: WarmingScene) -> list[dict[str, Any]]:
    """Offline corrections of single frames; nothing is followed from one to the next."""
    rng = np.random.default_rng(SEED)
    rest = np.mean([scene.frame(0.0) for _ in range(N_AVERAGED)], axis=0)
    rows: list[dict[str, Any]] = [
        {"name": name, "rms_um": 0.0, "max_um": 0.0, "frames": 0, "false_touches": 0} for name, _ in PEERS
    ]
    for time_s in np.arange(0.0, DURATION_S + 1, 4 * JUDGED_EVERY_S):
        now = np.mean([scene.frame(time_s) for _ in range(N_AVERAGED)], axis=0)
        for row, (_, order) in zip(rows, PEERS, strict=True):
            shown = now if order is None else corrected(now, rest, order)
            picture = np.clip(np.round(shown + rng.uniform(-0.5, 0.5, shown.shape)), 0, 255).astype(np.uint8)
            with Pipeline(board, calibration) as pipeline:
                _learn(pipeline, scene)
                result = pipeline.process(picture)
                rms_um, max_um = _depth_um(pipeline)
            row["frames"] += 1
            row["false_touches"] += int(result.n_contacts > 0)
            row["rms_um"], row["max_um"] = max(row["rms_um"], rms_um), max(row["max_um"], max_um)
    return rows


def run(board: Board, calibration: bytes, progress: Progress = lambda _: None) -> dict[str, Any]:
    """The board beside offline corrections.

    Raises
    ------
    InputError
        The board has no twin.
    """
    scene = WarmingScene(board)
    calibration = with_noise(board, calibration, scene)
    peers = _peers(board, calibration, scene)
    progress(0.1)
    row, press = _followed(board, calibration, scene, lambda done: progress(0.1 + 0.9 * done))
    return {"duration_s": DURATION_S, "held_s": HELD_S, "rows": [*peers, row], "press": press}


def table(result: dict[str, Any]) -> str:
    """The result as text."""
    press, (begin_s, end_s) = result["press"], result["held_s"]
    lines = [
        f"lamps that warm up apart for {result['duration_s']:.0f} s; a press of {press['force_n']:.3f} N is held from "
        f"{begin_s:.0f} to {end_s:.0f} s; depth of the untouched pad, worst frame",
        *aligned(("correction", "RMS", "largest", "false touches"), [
            (row["name"], f"{row['rms_um']:.1f} um", f"{row['max_um']:.1f} um",
             f"{row['false_touches']} of {row['frames']}")
            for row in result["rows"]
        ]),
    ]  # fmt: skip
    board = result["rows"][-1]
    lines += [
        f"board: LIGHT in {board['flagged']} untouched frames; {board['unflagged_um']:.1f} um RMS at most without it; "
        f"after the release at most {press['after_um']:.1f} um in {SETTLE_S:.0f} s, LIGHT in "
        f"{100 * press['after_flagged']:.0f} % of that",
        f"the press: {press['first_error_n']:+.3f} N off at first, {press['last_error_n']:+.3f} N at last, "
        f"{press['worst_unflagged_n']:.3f} N at most without LIGHT, which "
        f"{100 * press['flagged']:.0f} % of its frames have",
    ]
    return "\n".join(lines)
