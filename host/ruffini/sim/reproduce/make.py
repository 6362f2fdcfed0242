"""Recordings of a board's reproduce.toml: OUT/<set>/<number>/, each whole or not there, and what the bench read.

frames/, truth.npz, recording.toml   as every recording of the twin (`ruffini.sim.recording`)
rig.npz   force (t, 6) N and N m that the reference sensor read, depth_m (t,) where the stage said it was,
          shore_a that the tester read (NaN of a rigid one), place_m (2,) that a person noted,
          celsius (t,) that the board's thermometer says, of a bench with [warmth],
          gel_depth_m (t,) and area_m2 (t,) of the contact: truth that no sensor of the bench reads
run.json  part, indenter, and the run's value on each list of its set
"""

from __future__ import annotations

import hashlib
import io
import json
import shutil
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import lru_cache, partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board, find_board
from ruffini.errors import InputError, RuffiniError
from ruffini.files import write_whole
from ruffini.sim.recording import record_touches
from ruffini.sim.reproduce.runs import Run, readings_rng, runs_of
from ruffini.sim.reproduce.settings import (
    PAPER_BENCH,
    MountSettings,
    ReproduceSettings,
    RigSettings,
    WarmthSettings,
    load_reproduce,
)
from ruffini.sim.reproduce.solved import KeptMoment, aged, slowed, solved
from ruffini.sim.reproduce.warmth import celsius_read, risen, warmed, warmer_k
from ruffini.sim.rig import Unit
from ruffini.sim.settings import load_twin
from ruffini.sim.units import build_unit
from ruffini.version import __version__

Array = npt.NDArray[np.float64]
Progress = Callable[[float], None]
# Stages and sections of board.toml that change no picture of a twin, younger than the first frozen boards.
DIGEST_SCHEMA = 2  # to be raised with a change of the twin after which recordings are others
SEEN = {"camera", "pad", "grid", "markers"}  # sections of board.toml
RING_LEFT = 0.6  # of the ringing of a bench that has touched, from frame to frame


@dataclass(frozen=True)
class Outcome:
    """What `reproduce` did. `failed` : runs whose mechanics found no solution, with the reason."""

    n_made: int
    n_kept: int
    failed: dict[str, str]


def reproduce(
    board: Board,
    out: Path,
    *,
    bench: str = PAPER_BENCH,
    quick: bool = False,
    n_workers: int = 1,
    progress: Progress = lambda _: None,
) -> Outcome:
    """Make the runs of a bench that are not there yet.

    Raises
    ------
    InputError
        The board has no paper, the bench no quick subset, or the folder holds something else or cannot be written.
    """
    settings = load_reproduce(board, bench)
    runs = runs_of(settings, quick=quick)
    if not runs:
        raise InputError(f"{bench} of {board.name} has no quick subset: leave --quick out, or give its sets `quick`")
    _claim(out, board, bench)
    missing = [run for run in runs if not (out / run.key / "run.json").is_file()]
    failed: dict[str, str] = {}
    for done, (run, reason) in enumerate(_made(board, missing, out, bench, n_workers), 1):
        if reason:
            failed[run.key] = reason
        progress((len(runs) - len(missing) + done) / len(runs))
    return Outcome(len(missing) - len(failed), len(runs) - len(missing), failed)


def _made(board: Board, runs: list[Run], out: Path, bench: str, n_workers: int) -> Iterable[tuple[Run, str]]:
    name = str(board.folder or board.name)
    if n_workers == 1 or len(runs) < 2:
        yield from ((run, _make_one(name, run, out, bench)) for run in runs)
        return
    with ProcessPoolExecutor(n_workers, mp_context=get_context("spawn")) as pool:
        make_one = partial(_make_one, name, out=out, bench=bench)
        yield from zip(runs, pool.map(make_one, runs), strict=True)


@lru_cache(maxsize=1)
def _unit(board: str) -> Unit:
    return build_unit(find_board(board))


def _make_one(board: str, run: Run, out: Path, bench: str) -> str:
    """Make one run; the reason where its mechanics has no solution, else nothing."""
    unit = _unit(board)
    settings = load_reproduce(unit.board, bench)
    unit = slowed(aged(unit, settings.aging, run.n_pressed_before), run)
    warmth, kelvin, n_rest = settings.warmth or WarmthSettings(), warmer_k(run), unit.board.pipeline.n_rest_frames
    unit = warmed(unit, warmth, kelvin)
    try:
        moments = risen(solved(unit, run), warmth, kelvin, n_rest)
    except InputError:
        raise
    except RuffiniError as error:
        return str(error)
    folder = out / run.key
    begun = folder.with_name(f"{folder.name}.part")
    for rest in (begun, folder):  # of a run that was stopped
        shutil.rmtree(rest, ignore_errors=True)
    record_touches(unit, run.story(unit.board), begun, seed=run.seed, program=run.key, moments=moments)
    _write_rig(begun, run, moments, settings, unit.board)
    _write_run(begun, run)
    begun.rename(folder)
    return ""


def readings(run: Run, rig: RigSettings, wrench: Array, poses: Array, rate_hz: float) -> dict[str, Array]:
    """What the bench read in a run whose truth is `wrench` (t, 6) and `poses` (t, 6)."""
    rng, n = readings_rng(run), len(wrench)
    sigma = np.array([*(1e-6 * s for s in rig.force_noise_un), *(1e-9 * s for s in rig.torque_noise_nnm)])
    gain = 1 + rng.normal(size=6) * np.array([*rig.force_gain_1e4, *rig.torque_gain_1e4]) * 1e-4
    late = _late(wrench, rig.lag_ms * 1e-3 * rate_hz)
    force = late * gain + rng.normal(size=(n, 6)) * sigma
    arms = np.array([*(2 * [rig.crosstalk_1e4 * 1e-4]), 0, *(3 * [rig.moment_crosstalk_um * 1e-6])])
    force += late[:, 2:3] * arms
    force[:, 2] += _ringing(run, np.isfinite(poses[:, 0])) * rig.ring_force_un * 1e-6
    touched = poses[np.isfinite(poses[:, 0])]
    place = touched[-1, :2] if len(touched) else np.full(2, np.nan)
    shore = float(str(run.chosen.get("shore_a", "nan")))
    return {
        "force": force, "depth_m": poses[:, 2] + rng.normal() * rig.depth_noise_um * 1e-6,
        "shore_a": np.array(shore + rng.normal() * rig.shore_noise_1e1 * 0.1),
        "place_m": place + rng.normal(size=2) * rig.place_noise_um * 1e-6,
    }  # fmt: skip


def _ringing(run: Run, is_touched: npt.NDArray[np.bool_]) -> Array:
    """Of a bench that touches something: 1 in the mean of squares at first, (t,)."""
    since = np.cumsum(is_touched) - 1.0
    noise = np.random.default_rng([run.seed, 5]).normal(size=len(since))
    return np.where(is_touched, noise * RING_LEFT**since, 0.0)


def mount_zero(run: Run, mounts: list[MountSettings]) -> Array:
    """What the reference sensor reads in a run without any load, (6,) N and N m."""
    own = next((m for m in mounts if m.indenter == run.chosen.get("indenter")), None)
    if own is None:
        return np.zeros(6)
    sigma = np.array([*(2 * [own.zero_force_un * 1e-6]), 0.0, *(3 * [own.zero_torque_unm * 1e-6])])
    return np.asarray(np.random.default_rng([run.seed, 4]).normal(size=6) * sigma)


def _write_rig(folder: Path, run: Run, moments: list[KeptMoment], settings: ReproduceSettings, board: Board) -> None:
    rig = settings.rig
    wrench, poses = np.array([m.wrench() for m in moments]), np.array([m.pose_row() for m in moments])
    arrays = readings(run, rig, wrench, poses, board.camera.rate_mhz * 1e-3)
    arrays["force"] += mount_zero(run, settings.mount)
    arrays["gel_depth_m"] = np.array([m.gel_depth_m for m in moments])
    arrays["area_m2"] = np.array([m.area_m2 for m in moments])
    if settings.warmth is not None:
        arrays["celsius"] = celsius_read(run, settings.warmth, len(moments), board.pipeline.n_rest_frames)
    if any(rig.displacement_noise_um):
        nodes = np.array([m.nodal_displacement() for m in moments])
        noise = np.random.default_rng([run.seed, 3]).normal(size=nodes.shape)
        arrays["displacement_m"] = nodes + noise * np.array(rig.displacement_noise_um) * 1e-6
    stream = io.BytesIO()
    np.savez(stream, allow_pickle=False, **arrays)
    write_whole(folder / "rig.npz", stream.getvalue(), is_durable=False)


def _late(rows: Array, frames: float) -> Array:
    """Rows (t, k) as they were `frames` frames before."""
    at = np.maximum(np.arange(len(rows)) - frames, 0)
    return np.stack([np.interp(at, np.arange(len(rows)), column) for column in rows.T], axis=1)


def _write_run(folder: Path, run: Run) -> None:
    tree = {
        "simulated": True, "key": run.key, "part": run.settings.part, "what": run.settings.what,
        "seed": run.seed, "chosen": run.chosen,
    }  # fmt: skip
    write_whole(folder / "run.json", json.dumps(tree, indent=1).encode(), is_durable=False)


def digest(board: Board, bench: str = PAPER_BENCH) -> str:
    """Of all that a board's recordings follow from: the bench, twin.toml, and what the twin reads of board.toml.

    How many runs are drawn of a set does not count: more of them leave those that are there as they are.
    """
    told = load_reproduce(board, bench).model_dump(mode="json", exclude={"method", "published"})
    for one in told["set_"]:
        one["drawn"] = one["drawn"] is not None
    tree = {
        "schema": DIGEST_SCHEMA,
        "board": {**board.model_dump(mode="json", include=SEEN), "n_rest_frames": board.pipeline.n_rest_frames},
        "twin": load_twin(board).model_dump(mode="json"),
        "bench": told,
    }
    return hashlib.sha256(json.dumps(tree, sort_keys=True).encode()).hexdigest()


def _claim(out: Path, board: Board, bench: str) -> None:
    """Make the folder ours, or go on in it. Raises InputError where it holds something else."""
    card = out / "reproduce.json"
    paper = load_reproduce(board, bench).paper
    ours = {"simulated": True, "board": board.name, "paper": paper, "settings": digest(board, bench),
            "ruffini": __version__}  # fmt: skip
    try:
        if card.is_file():
            if json.loads(card.read_text()) != ours:
                raise InputError(f"{out} holds recordings of another board, twin or version: choose another --out")
            return
        if out.exists() and (not out.is_dir() or any(out.iterdir())):
            raise InputError(f"{out} is there already and is not an empty folder: choose another --out")
    except (OSError, ValueError) as error:
        raise InputError(f"{card} cannot be read ({error}): choose another --out") from error
    write_whole(card, json.dumps(ours, indent=1).encode(), remedy="make room and choose another --out")
