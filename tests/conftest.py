"""The order of the test modules: the longest first, by what each took last time, so that no worker ends with it alone.

RUFFINI_TEST_ORDER=SEED shuffles the modules and the tests within each instead: no test may depend on another.
"""

from __future__ import annotations

import gc
import hashlib
import json
import os
import random
import signal
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import hypothesis
import pytest
from hang import HANG_S
from kept import cache_folder

os.environ["RUFFINI_PATIENCE"] = "20"  # before the host is imported: it waits as long as a guard against a hang

from ruffini.device import ports
from ruffini.estimators.material import model as material

COSTS = "module_seconds.json"
LONG_S = 1e3  # what a module of end-to-end tests is taken for before it ever ran: first
SYSTEMS_BYTES = 500_000_000  # kept by a worker
_seconds: dict[str, float] = defaultdict(float)
_processor_s: list[float] = []  # of each worker with the processes that it started; a busy computer changes it little


def _known() -> dict[str, float]:
    try:
        return dict(json.loads((cache_folder() / COSTS).read_text()))
    except (OSError, ValueError):
        return {}


def pytest_configure() -> None:
    """What the product keeps between runs is the tests' own, and not the person's.

    Processes in the background of a shell may ignore Ctrl-C, and so does all that they start; tests send it.

    A worker is a session of its own: Linux shares the processor between sessions first (sched_autogroup). In one
    session with everything that is busy, the tests also wait for the kernel's threads outside it, which move each byte
    of a pseudo-terminal and came to that after 20 ms instead of 0.2 beside three busy loops. Ctrl-C reaches a worker
    through the controller. What opens a terminal needs O_NOCTTY, or the worker ends when that terminal hangs up.
    """
    os.environ["RUFFINI_TEST_CACHE"] = str(cache_folder())
    os.environ["XDG_CACHE_HOME"] = str(cache_folder() / "product")
    if "PYTEST_XDIST_WORKER" in os.environ:  # the controller collects nothing
        gc.disable()  # until all is collected
        os.setsid()
    hypothesis.settings.register_profile("tests", deadline=None)  # no real time judges a test
    hypothesis.settings.load_profile("tests")
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node: Any) -> None:
    """All workers of pytest-xdist must have one order: they get it from the controller."""
    node.workerinput["module_seconds"] = _known()


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    modules: dict[str, list[pytest.Item]] = {}
    for item in items:
        modules.setdefault(item.path.name, []).append(item)
    names = list(modules)
    seed = os.environ.get("RUFFINI_TEST_ORDER")
    if seed:
        chances = random.Random(seed)
        chances.shuffle(names)
        for tests in modules.values():
            chances.shuffle(tests)
    else:
        known = getattr(config, "workerinput", {}).get("module_seconds", _known())
        guessed = {
            name: LONG_S if tests[0].path.parent.name == "e2e" else len(tests) for name, tests in modules.items()
        }
        names.sort(key=lambda name: (-known.get(name, guessed[name]), name))
    items[:] = [item for name in names for item in modules[name]]


@pytest.hookimpl(trylast=True)
def pytest_collection_finish() -> None:
    """Modules and tests live until the end: a look through all of them for garbage takes 0.2 s, each time."""
    gc.freeze()
    gc.enable()


@pytest.fixture(scope="session", autouse=True)
def _patient_host() -> Iterator[None]:
    """The kernel of a busy computer moves what was written to a pseudo-terminal when it comes to it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ports, "WRITE_TIMEOUT_S", HANG_S)
        yield


@pytest.fixture(scope="module", autouse=True)
def _systems_of_a_board_made_once() -> Iterator[None]:
    """A fit of a pad makes nine, its report and the module's next fit the same ones: the newest are kept."""
    made: dict[tuple[Any, ...], Any] = {}
    make = material.system_of

    def system_of(slab: Any, noise: Any, observed: Any, operator: Any) -> Any:
        key = (slab, noise, observed.tobytes(), hashlib.sha256(operator.tobytes()).digest())
        system = made.pop(key, None) or make(slab, noise, observed, operator)
        made[key] = system
        while sum(one.normal.nbytes + one.project.nbytes for one in made.values()) > SYSTEMS_BYTES:
            made.pop(next(iter(made)))
        return system

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(material, "system_of", system_of)
        yield


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    _seconds[Path(report.location[0]).name] += report.duration
    if report.failed and "PYTEST_XDIST_WORKER" not in os.environ:  # at once: the run goes on for minutes
        print(f"\n{report.when} failed: {report.nodeid}", file=sys.stderr, flush=True)


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    _processor_s.append(getattr(node, "workeroutput", {}).get("processor_s", 0.0))


def pytest_terminal_summary(terminalreporter: Any) -> None:
    own_s, started_s = sum(os.times()[:2]), sum(os.times()[2:4])  # workers that have ended are among the started
    terminalreporter.write_line(f"{own_s + (sum(_processor_s) or started_s):.0f} s of processor time")


def pytest_sessionfinish(session: pytest.Session) -> None:
    if hasattr(session.config, "workerinput"):
        session.config.workeroutput["processor_s"] = sum(os.times()[:4])
        return
    if not _seconds:
        return
    folder = cache_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        temporary = folder / f"{COSTS}.{os.getpid()}"
        temporary.write_text(json.dumps({**_known(), **_seconds}, indent=0, sort_keys=True))
        temporary.replace(folder / COSTS)
    except OSError:
        pass  # the next run has a worse order
