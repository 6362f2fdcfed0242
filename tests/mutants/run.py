"""Plants the bugs of seeded_bugs.toml one by one in a copy of the tree; each must be seen by its layer of tests.

    python tests/mutants/run.py --build build [--only WORDS]

Prints for each bug what its layer does: it fails, or hangs, which kills the bug as well. Ends with 1 where one
survives, does not fit the source any more, or does not compile.
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
import tomllib
from pathlib import Path

REPO = Path(__file__).parents[2]
TIMEOUT_S = 300.0
HOST_TARGETS = ("ruffini", "ruffini_schema", "ruffini_infer")  # what the host tool loads


def copied_tree(folder: Path) -> Path:
    """The tracked files, and no others, newer only where they differ: what was built stays so."""
    listed = subprocess.run(["git", "-C", str(REPO), "ls-files", "-z"], capture_output=True, text=True, check=True)
    names = [name for name in listed.stdout.split("\0") if name and (REPO / name).is_file()]
    for name in names:
        there, data = folder / name, (REPO / name).read_bytes()
        if not there.is_file() or there.read_bytes() != data:
            there.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(REPO / name, there)
    return folder


class Tree:
    """The copy and its build."""

    def __init__(self, root: Path, build: Path) -> None:
        self.root, self.build = root, build
        self.environment = {
            **os.environ, "PYTHONPATH": str(root / "host"), "RUFFINI_NATIVE_DIR": str(build / "native"),
            "RUFFINI_DAEMON": str(build / "ruffinid"), "RUFFINI_CRASH_STEP": "1024", "PYTHONDONTWRITEBYTECODE": "1",
        }  # fmt: skip

    def make(self, *targets: str) -> str:
        """Build; empty, or what the compiler said."""
        command = ["cmake", "--build", str(self.build), "--target", *targets]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        return "" if done.returncode == 0 else done.stdout[-2000:] + done.stderr[-2000:]

    def run(self, layer: str) -> str:
        """What a layer of tests does: passes, fails, or hangs."""
        command = shlex.split(layer.format(build=self.build, python=sys.executable))
        try:
            done = subprocess.run(
                command, cwd=self.root, env=self.environment, capture_output=True, text=True, check=False,
                timeout=TIMEOUT_S,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return "hangs"
        return "passes" if done.returncode == 0 else "fails"


def targets_of(layer: str) -> list[str]:
    """What a layer runs: its own program, or the daemon where its tests are in Python."""
    return re.findall(r"\{build\}/(\w+)", layer) or ["ruffinid"]


def verdict(tree: Tree, bug: dict[str, str], layers: dict[str, str]) -> str:
    """How a bug shows, "fails" or "hangs", or what is wrong."""
    path = tree.root / bug["file"]
    source = path.read_text()
    if source.count(bug["find"]) != 1:
        return f"NOT PLANTED: the text is {source.count(bug['find'])} times in the file"
    try:
        path.write_text(source.replace(bug["find"], bug["put"]))
        is_compiled = path.suffix in (".cpp", ".h")
        said = tree.make(*targets_of(layers[bug["layer"]])) if is_compiled else ""
        if said:
            return f"DOES NOT COMPILE: {said}"
        said = tree.run(layers[bug["layer"]])
        return "SURVIVES" if said == "passes" else said
    finally:
        path.write_text(source)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--build", type=Path, default=REPO / "build")
    parser.add_argument("--only", default="", help="bugs whose name or layer has these words")
    given = parser.parse_args()
    folder = given.build.resolve() / "mutants"
    plan = tomllib.loads((Path(__file__).parent / "seeded_bugs.toml").read_text())
    bugs = [bug for bug in plan["bug"] if given.only in bug["name"] + " " + bug["layer"]]
    tree = Tree(copied_tree(folder / "tree"), folder / "build")
    configure = ["cmake", "-G", "Ninja", "-S", str(tree.root), "-B", str(tree.build), "-DCMAKE_CXX_FLAGS=-O1"]
    subprocess.run(configure, stdout=subprocess.DEVNULL, check=True)
    said = tree.make(*HOST_TARGETS, *sorted({t for layer in plan["layers"].values() for t in targets_of(layer)}))
    if said:
        print(said, file=sys.stderr)
        return 1
    for name in sorted({bug["layer"] for bug in bugs}):
        if (said := tree.run(plan["layers"][name])) != "passes":
            print(f"layer {name} {said} without any bug: mend that first", file=sys.stderr)
            return 1
    n_hung = n_wrong = 0
    for bug in bugs:
        start = time.monotonic()
        said = verdict(tree, bug, plan["layers"])
        n_hung += said == "hangs"
        n_wrong += said not in ("fails", "hangs")
        print(f"{said:9}  {bug['layer']:13} {time.monotonic() - start:5.0f} s  {bug['name']}", flush=True)
    print(
        f"{len(bugs)} seeded bugs, {len(bugs) - n_wrong} killed, {n_hung} of them by {TIMEOUT_S:.0f} s without an end"
    )
    return 1 if n_wrong else 0


if __name__ == "__main__":
    sys.exit(main())
