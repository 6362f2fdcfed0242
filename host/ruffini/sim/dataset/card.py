"""The dataset's card: what a stranger must know before using it."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np

from ruffini.sim.dataset.plan import PLAN_FILE, Plan
from ruffini.sim.dataset.shard import FIELDS

PRESSES = {
    "plane": "a rigid ball or flat punch, half of them sheared.",
    "dome": "a rigid flat circle, square or hexagon, a third of them on a turned sensor.",
    "tube": "a rigid ball.",
}


def shard_name(shard: int) -> str:
    return f"shard-{shard:05d}.h5"


def _type_name(dtype: np.dtype[Any]) -> str:
    return "text" if dtype.kind == "S" else str(dtype.name)


def card(plan: Plan, folder: Path) -> str:
    """README.md of a finished dataset, with the checksum of every shard."""
    import h5py

    board = plan.board()
    rows = []
    with h5py.File(folder / shard_name(0), "r") as first:
        for name, meaning in FIELDS.items():
            shape = " x ".join(str(k) for k in first[name].shape[1:]) or "1"
            rows.append(f"| `{name}` | {shape} | {_type_name(first[name].dtype)} | {meaning} |")
    sums = []
    for shard in range(plan.n_shards):
        digest = hashlib.sha256((folder / shard_name(shard)).read_bytes()).hexdigest()
        sums.append(f"| {shard_name(shard)} | {len(plan.indices(shard))} | {digest} |")
    return (
        f"# {board.name}: {plan.n} simulated presses\n\n"
        f"**Simulated**, by the digital twin of board `{board.name}` ({board.board.product}) in ruffini "
        f"{plan.version}. No real sensor took part.\n\n"
        f"Each sample is one press, held: {PRESSES[plan.twin().shape.kind]} Places, sizes and depths are\n"
        "drawn uniformly (`ruffini.sim.bodies.touches.random_touch`). Mechanics and their limits are in the board's "
        "README.md.\n\n"
        f"Seed {plan.seed}; sample i follows from the plan ({PLAN_FILE}: both TOML files, seed, version) and i alone, "
        "whoever made it.\n"
        f"True pad over the board's numbers: modulus {plan.scale_modulus:g}, Poisson's ratio {plan.scale_poisson:g}, "
        f"thickness {plan.scale_thickness:g}.\n\n"
        "Axes: origin at the middle of the untouched surface, x right and y down in the image, z out of the pad; "
        "forces act on the pad.\n\n"
        "| dataset | shape of a sample | type | unit and meaning |\n| --- | --- | --- | --- |\n"
        + "\n".join(rows)
        + "\n\n```python\nimport h5py\n\n"
        f'with h5py.File("{shard_name(0)}") as shard:\n    image, force = shard["image"][0], shard["force"][0]\n```\n\n'
        "| file | samples | SHA-256 |\n| --- | --- | --- |\n" + "\n".join(sums) + "\n"
    )
