"""One shard: a range of samples as an HDF5 file in memory, the same bytes wherever it is made."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.errors import RuffiniError
from ruffini.sim.bodies.touches import random_touch
from ruffini.sim.dataset.plan import Plan
from ruffini.sim.optics.renderer import Renderer
from ruffini.sim.programs import Touch
from ruffini.sim.rig import Unit
from ruffini.sim.story import Moment, play
from ruffini.sim.units import build_unit

MAX_ATTEMPTS = 5  # presses drawn for one sample, where the contact solver gives up
MAX_NAME = 32  # characters of a shape's name
N_REFERENCES = 4  # untouched pictures in each shard

# name -> unit and meaning, as the card and the files' attributes say it
FIELDS = {
    "image": "grey levels 0 to 255, B G R: the frame of the held press",
    "reference": "grey levels 0 to 255, B G R: frames of the untouched pad, the same for all samples but the noise",
    "index": "number of the sample in the dataset",
    "wrench": "N and N m: force on the pad and moment about its centre",
    "force": "N: nodal force on the pad, rows of nodes over the whole pad, x y z",
    "displacement": "m: of the surface at the nodes, x y z",
    "pose": "m, m, m, rad, rad, rad: x, y and depth of the indenter's lowest point, turn, roll, pitch (about z, x, y)",
    "contact": "at the nodes: 0 free, 1 sticks, 2 slips",
    "shape": "name of the indenter's shape",
    "radius_m": "m: radius of the indenter",
    "attempt": "which drawn press this is: above 0 where the contact solver gave up on the ones before",
}


@dataclass(frozen=True)
class _Workshop:
    unit: Unit
    renderer: Renderer


@functools.lru_cache(maxsize=1)
def _workshop(plan_json: str) -> _Workshop:
    """Once a process: the unit's mechanics and camera. One thread each: the processes share the cores."""
    import cv2

    cv2.setNumThreads(1)
    plan = Plan.model_validate_json(plan_json)
    unit = build_unit(plan.board(), plan.error(), twin=plan.twin())
    return _Workshop(unit, unit.renderer())


def _held(unit: Unit, touch: Touch) -> Moment:
    """The judged moment of a touch."""
    return next(moment for moment in play(unit, [touch]) if moment.judged)


def _sample(shop: _Workshop, plan: Plan, index: int) -> dict[str, Any]:
    rng = np.random.default_rng([plan.seed, index])
    for attempt in range(MAX_ATTEMPTS):
        touch = random_touch(shop.unit.board, shop.unit.twin, rng)
        try:
            moment = _held(shop.unit, touch)
        except RuffiniError:
            continue
        return {
            "image": shop.renderer.image(moment.displacement, rng, tray=moment.tray), "index": index,
            "wrench": moment.wrench(),
            "force": moment.nodal_force().astype(np.float32),
            "displacement": moment.nodal_displacement().astype(np.float32), "pose": moment.pose_row(),
            "contact": moment.nodal_state(),
            "shape": touch.indenter.shape, "radius_m": touch.indenter.radius_m, "attempt": attempt,
        }  # fmt: skip
    raise RuffiniError(f"sample {index}: the contact solver gave up on {MAX_ATTEMPTS} presses: choose another --seed")


def make_shard(plan_json: str, shard: int) -> bytes:
    """A shard as the bytes of an HDF5 file. Depends on nothing but its arguments.

    Raises
    ------
    RuffiniError
        This process runs another version of ruffini, or a sample cannot be made.
    """
    import h5py
    from threadpoolctl import threadpool_limits

    from ruffini.version import __version__

    plan = Plan.model_validate_json(plan_json)
    if plan.version != __version__:
        raise RuffiniError(f"a worker runs ruffini {__version__}, the dataset is of {plan.version}: update the worker")
    with threadpool_limits(1):
        shop = _workshop(plan_json)
        samples = [_sample(shop, plan, index) for index in plan.indices(shard)]
        rng = np.random.default_rng([plan.seed, plan.n, shard])
        reference = np.stack([shop.renderer.image(shop.unit.at_rest(), rng) for _ in range(N_REFERENCES)])
    file = BytesIO()
    with h5py.File(file, "w") as out:
        # Texts have fixed lengths: HDF5's heap for others holds bytes of whatever was in memory before.
        texts = {"plan_sha256": plan.sha256(), "plan": plan_json}
        out.attrs.update({"simulated": True, "shard": shard, **{k: np.bytes_(v.encode()) for k, v in texts.items()}})
        for name in samples[0]:
            _put(out, name, np.array([sample[name] for sample in samples]))
        _put(out, "reference", reference)
    return file.getvalue()


def _put(out: Any, name: str, values: npt.NDArray[Any]) -> None:
    """A dataset with its meaning; arrays compressed sample by sample, with a checksum."""
    options: dict[str, Any] = {}
    if values.ndim > 2:
        options = {"chunks": (1, *values.shape[1:]), "compression": "gzip", "compression_opts": 1,
                   "shuffle": True, "fletcher32": True}  # fmt: skip
    if values.dtype.kind == "U":
        values = np.char.encode(values, "ascii").astype(f"S{MAX_NAME}")
    out.create_dataset(name, data=values, **options).attrs["unit"] = np.bytes_(FIELDS[name].encode())
    out.flush()  # in this order, whenever Python closes the dataset: the file's layout repeats


def is_whole(path: Path, plan: Plan, shard: int) -> bool:
    """Whether a file is this plan's shard, with every sample in its place."""
    import h5py

    try:
        with h5py.File(path, "r") as file:
            is_of_plan = file.attrs["plan_sha256"] == plan.sha256().encode() and file.attrs["shard"] == shard
            return bool(is_of_plan and file["index"][:].tolist() == list(plan.indices(shard)))
    except (OSError, KeyError, RuntimeError):
        return False
