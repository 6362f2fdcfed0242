"""Plants the bugs of seeded_bugs.toml one by one in copies of the tree; each must be seen by its layer of tests.

    python tests/mutants/mutants.py --build build [--only WORDS] [--turn I/N] [--jobs N]
                                    [--tests-that-never-caught FILE]

A layer is a command of seeded_bugs.toml, or a test file: of gtest, pytest or the page. A bug in C++ rebuilds its
layer's program and no more; other bugs are not compiled. Prints for each bug whether its layer fails or hangs, which
kills it too. Exit code 1 if a bug survives, does not fit the source any more, or does not compile.
"""

from __future__ import annotations

import argparse
import os
import queue
import re
import shlex
import shutil
import subprocess
import sys
import threading
import time
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import tomllib

REPO = Path(__file__).parents[2]
TIMEOUT_S = 300.0
MEMORY_BYTES = 2 << 30  # of a C++ test program: a bug that never stops collecting would take the computer
HOST_TARGETS = ("ruffini", "ruffini_schema", "ruffini_infer", "ruffini_pictures")  # what the host tool loads
BUILD_TARGETS_OF = {
    "tests/bitexact": ("ruffini_stages", "ruffini"),
    "tests/py/client": ("ruffini_client_door",),
    "tests/py/api": ("ruffini_client_door", "ruffinid"),
}
SUITE = re.compile(r"^(?:TYPED_)?TEST(?:_[FP])?\(\s*(\w+)", re.M)


@dataclass(frozen=True)
class Layer:
    """One command that runs tests; `targets` are built before it, where a C++ file has changed."""

    name: str
    command: str
    targets: tuple[str, ...]


def programs_of_tests() -> dict[str, str]:
    """The program that each C++ test file is compiled into, read from CMakeLists.txt with its lists by pattern."""
    text = (REPO / "CMakeLists.txt").read_text()
    for name, pattern in re.findall(r"file\(GLOB (\w+) CONFIGURE_DEPENDS (tests/\S+)\)", text):
        found = " ".join(str(path.relative_to(REPO)) for path in sorted(REPO.glob(pattern)))
        text = text.replace(f"${{{name}}}", found)
    blocks = re.findall(r"(?:add_executable|target_sources)\((\w+)\s(.*?)\)\n", text, re.S)
    return {path: name for name, body in blocks for path in re.findall(r"tests/[\w/]+_test\.cpp", body)}


def layer_of(name: str, commands: dict[str, str]) -> Layer:
    """A layer by its name in seeded_bugs.toml, or that of one test file."""
    if name in commands:
        command = commands[name]
        of_folders = {one for folder, targets in BUILD_TARGETS_OF.items() if folder in command for one in targets}
        return Layer(name, command, tuple(re.findall(r"\{build\}/(\w+)", command) or sorted({"ruffinid", *of_folders})))
    if not (REPO / name).exists():
        raise SystemExit(f"layer {name!r} is neither in [layers] nor a test file")
    if name.endswith(".cpp"):
        program = programs_of_tests()[name]
        suites = sorted(set(SUITE.findall((REPO / name).read_text())))
        chosen = ":".join(f"{suite}.*:*/{suite}.*" for suite in suites)
        return Layer(name, f"{{build}}/{program} --gtest_filter={chosen} --gtest_brief=1", (program,))
    if name.endswith(".ts"):
        return Layer(name, f"npx --prefix host/page vitest run --config host/page/vitest.config.ts {name}", ())
    found = (targets for folder, targets in BUILD_TARGETS_OF.items() if name.startswith(folder))
    return Layer(name, f"{{python}} -m pytest -c host/pyproject.toml -q {name}", next(found, ("ruffinid", "ruffini")))


def copied_tree(folder: Path) -> Path:
    """The tracked files, and no others, newer only where they differ: what was built stays so."""
    listed = subprocess.run(["git", "-C", str(REPO), "ls-files", "-z"], capture_output=True, text=True, check=True)
    names = {name for name in listed.stdout.split("\0") if name and (REPO / name).is_file()}
    for name in names:
        there, data = folder / name, (REPO / name).read_bytes()
        if not there.is_file() or there.read_bytes() != data:
            there.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(REPO / name, there)
    for old in (path for part in ("tests", "host") for path in (folder / part).rglob("*.*")):
        if (
            old.suffix in (".py", ".ts")
            and "node_modules" not in old.parts
            and str(old.relative_to(folder)) not in names
        ):
            old.unlink()  # a test that was renamed must not run under its old name as well
    for installed in ("host/page/node_modules", ".venv/libgpiod"):  # the latter where apt has version 1
        link = folder / installed
        if (REPO / installed).is_dir() and not link.exists():
            link.parent.mkdir(parents=True, exist_ok=True)
            link.symlink_to((REPO / installed).resolve())
    return folder


@dataclass
class Outcome:
    """What a layer did: it passes, fails or hangs; the ids of all its tests and of those that failed."""

    said: str
    tests: frozenset[str] = frozenset()
    failed: frozenset[str] = frozenset()


def read_report(path: Path) -> tuple[frozenset[str], frozenset[str]]:
    """Ids of the tests in a JUnit report, and of those that failed; none where the layer wrote no report."""
    try:
        cases = [case for case in ElementTree.parse(path).iter("testcase") if case.find("skipped") is None]
    except (OSError, ElementTree.ParseError):
        return frozenset(), frozenset()
    names = [
        (f"{case.get('file') or case.get('classname')}::{case.get('name')}", case)
        for case in cases
        if case.get("status") != "notrun"
    ]
    failed = {name for name, case in names if case.find("failure") is not None or case.find("error") is not None}
    return frozenset(name for name, _ in names), frozenset(failed)


class Tree:
    """A copy of the tree and its build."""

    def __init__(self, folder: Path) -> None:
        self.root, self.build, self.report = copied_tree(folder / "tree"), folder / "build", folder / "report.xml"
        self.environment = {
            **os.environ, "PYTHONPATH": str(self.root / "host"), "RUFFINI_NATIVE_DIR": str(self.build / "native"),
            "RUFFINI_DAEMON": str(self.build / "ruffinid"), "RUFFINI_CRASH_STEP": "1024",
            "PYTHONDONTWRITEBYTECODE": "1",
            "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "CCACHE_BASEDIR": str(folder), "CCACHE_NOHASHDIR": "1",
        }  # fmt: skip

    def configure(self) -> str:
        """Empty, or what CMake said."""
        ccache = shutil.which("ccache")
        launchers = [f"-DCMAKE_{language}_COMPILER_LAUNCHER={ccache or ''}" for language in ("C", "CXX")]
        command = [
            "cmake",
            "-G",
            "Ninja",
            "-S",
            str(self.root),
            "-B",
            str(self.build),
            "-DRUFFINI_PAGE=OFF",
            *launchers,
        ]
        return self._said(command, {})

    def make(self, *targets: str, is_planted: bool = False) -> str:
        """Build; empty, or what the compiler said. A planted bug is not worth a place in ccache."""
        command = ["cmake", "--build", str(self.build), "-j", "2", "--target", *targets]
        return self._said(command, {"CCACHE_DISABLE": "1"} if is_planted else {})

    def _said(self, command: Sequence[str], more: dict[str, str]) -> str:
        done = subprocess.run(command, capture_output=True, text=True, check=False, env={**self.environment, **more})
        return "" if done.returncode == 0 else done.stdout[-2000:] + done.stderr[-2000:]

    def run(self, layer: Layer) -> Outcome:
        """Run a layer; a hanging one is ended after TIMEOUT_S."""
        command = shlex.split(layer.command.format(build=self.build, python=sys.executable))
        if "pytest" in command:
            command += [
                f"--junitxml={self.report}",
                "-o",
                "junit_family=xunit1",
                "-p",
                "no:cacheprovider",
            ]  # names files
        elif "vitest" in command:
            command += ["--reporter=junit", f"--outputFile={self.report}"]
        elif any("--gtest" in word for word in command):
            command += [f"--gtest_output=xml:{self.report}"]
        if command[0].startswith(str(self.build)):
            command = ["prlimit", f"--data={MEMORY_BYTES}", *command]
        self.report.unlink(missing_ok=True)
        quiet = subprocess.DEVNULL
        with subprocess.Popen(
            command, cwd=self.root, env=self.environment, stdout=quiet, stderr=quiet, start_new_session=True
        ) as process:
            try:
                code = process.wait(TIMEOUT_S)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, 9)  # its children as well: a daemon would go on
                return Outcome("hangs")
        tests, failed = read_report(self.report)
        if not tests:  # no test framework, or it did not come to its report
            alone = frozenset({layer.name})
            return Outcome("passes", alone) if code == 0 else Outcome("fails", alone, alone)
        return Outcome("passes" if code == 0 else "fails", tests, failed)

    def plant(self, bug: dict[str, str], layer: Layer) -> Outcome:
        """Plant a bug, run its layer, and restore the file."""
        path = self.root / bug["file"]
        source = path.read_text()
        if (n := source.count(bug["find"])) != 1:
            return Outcome(f"NOT PLANTED: the text is {n} times in the file")
        try:
            path.write_text(source.replace(bug["find"], bug["put"]))
            is_compiled = path.suffix in (".cpp", ".h") and layer.targets
            problem = self.make(*layer.targets, is_planted=True) if is_compiled else ""
            return Outcome(f"DOES NOT COMPILE: {problem}") if problem else self.run(layer)
        finally:
            path.write_text(source)


@dataclass
class Tally:
    """What all trees found."""

    tests: dict[str, frozenset[str]] = field(default_factory=dict)  # of each layer, without any bug
    failures: Counter[str] = field(default_factory=Counter)  # bugs that a test caught
    said: Counter[str] = field(default_factory=Counter)
    caught: Counter[str] = field(default_factory=Counter)  # by layer
    wrong: list[str] = field(default_factory=list)


def checked_layers(tree: Tree, layers: Sequence[Layer], tally: Tally) -> list[str]:
    """Run each layer without any bug; what is wrong with those that do not pass."""
    found = []
    for layer in layers:
        outcome = tree.run(layer)
        tally.tests[layer.name] = outcome.tests
        if outcome.said != "passes":
            names = ", ".join(sorted(outcome.failed)[:5])
            found.append(f"layer {layer.name} {outcome.said} without any bug: mend that first: {names}")
    return found


def play(tree: Tree, work: queue.Queue[dict[str, str]], layers: dict[str, Layer], tally: Tally) -> None:
    """One tree's share of the bugs, until none is left."""
    while True:
        try:
            bug = work.get_nowait()
        except queue.Empty:
            return
        start = time.monotonic()
        try:
            outcome = tree.plant(bug, layers[bug["layer"]])
        except OSError as error:
            outcome = Outcome(f"NOT PLAYED: {error}")
        said = "SURVIVES" if outcome.said == "passes" else outcome.said
        tally.said[said] += 1
        tally.failures.update(outcome.failed)
        if said in ("fails", "hangs"):
            tally.caught[bug["layer"]] += 1
        else:
            tally.wrong.append(f"{bug['name']} ({bug['file']}): {said}")
        print(f"{said:9}  {time.monotonic() - start:5.0f} s  {bug['layer']:30}  {bug['name']}", flush=True)


def idle_tests(tally: Tally) -> list[str]:
    """Tests of all layers that failed for none of the bugs; a test of several layers counts once."""
    return sorted(name for name in frozenset().union(*tally.tests.values()) if not tally.failures[name])


def table(tally: Tally) -> str:
    """Bugs caught by each layer, then the tests that caught none, by file or suite."""
    layers = [f"{tally.caught[layer]:4} bugs caught by {layer}" for layer in sorted(tally.tests)]
    idle = idle_tests(tally)
    by_file = Counter(name.rpartition("::")[0] for name in frozenset().union(*tally.tests.values()))
    out = []
    for file, n in sorted(by_file.items()):
        names = [name for name in idle if name.rpartition("::")[0] == file]
        out += [f"{file or 'programs'}: {len(names)} of {n} tests caught none", *(f"  {name}" for name in names)]
    return "\n".join([*layers, "", *out]) + "\n"


def chosen_bugs(bugs: list[dict[str, str]], only: str, turn: str) -> list[dict[str, str]]:
    """The bugs that `only` finds; of turn I/N each N-th. Sorted by file: neighbours rebuild the same objects."""
    index, n = (int(part) for part in turn.split("/"))
    if not 0 <= index < n:
        raise SystemExit(f"--turn {turn}: from 0/{n} to {n - 1}/{n}")
    found = [bug for bug in bugs if re.search(only, f"{bug['name']} {bug['layer']} {bug['file']}")]
    return sorted(found[index::n], key=lambda bug: (bug["file"], bug["layer"]))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--build", type=Path, default=REPO / "build")
    parser.add_argument("--only", default="", help="bugs whose name, layer or file this regular expression finds")
    parser.add_argument("--turn", default="0/1", metavar="I/N", help="each N-th bug, from the I-th, 0 the first")
    parser.add_argument("--jobs", type=int, default=1, help="trees side by side")
    parser.add_argument("--tests-that-never-caught", type=Path, metavar="FILE", help="where to write that table")
    given = parser.parse_args()
    plan = tomllib.loads((Path(__file__).parent / "seeded_bugs.toml").read_text())
    bugs = chosen_bugs(plan["bug"], given.only, given.turn)
    layers = {name: layer_of(name, plan["layers"]) for name in sorted({bug["layer"] for bug in bugs})}
    targets = sorted({*HOST_TARGETS, "ruffinid"}.union(*(layer.targets for layer in layers.values())))
    trees = [Tree(given.build.resolve() / "mutants" / str(i)) for i in range(max(given.jobs, 1))]
    for tree in trees:
        if problem := tree.configure() or tree.make(*targets):
            print(problem, file=sys.stderr)
            return 1
    tally = Tally()
    if found := checked_layers(trees[0], list(layers.values()), tally):
        print("\n".join(found), file=sys.stderr)
        return 1
    work: queue.Queue[dict[str, str]] = queue.Queue()
    for bug in bugs:
        work.put(bug)
    threads = [threading.Thread(target=play, args=(tree, work, layers, tally)) for tree in trees]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if given.tests_that_never_caught:
        given.tests_that_never_caught.write_text(table(tally))
    n_killed, n_hung = tally.said["fails"] + tally.said["hangs"], tally.said["hangs"]
    print(*tally.wrong, sep="\n", end="\n" if tally.wrong else "")
    print(f"{len(bugs)} seeded bugs, {n_killed} killed, {n_hung} of them by {TIMEOUT_S:.0f} s without an end")
    n_tests = len(frozenset().union(*tally.tests.values()))
    print(f"{len(idle_tests(tally))} of {n_tests} tests of these layers caught none of them")
    return 1 if n_killed < len(bugs) else 0


if __name__ == "__main__":
    sys.exit(main())
