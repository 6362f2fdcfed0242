"""What the page of `ruffini view` does in headless Chromium: weight, first frame, fields a second, delay, stages.

A device on a pty answers as a sensor does and writes WRENCH and FIELD of 1,209 nodes (force, displacement, sigma) at
a pace; the real server and the real page take them. Delay: from before a frame is written on the pty until the page
has drawn it, its WebGL commands handed over; by the computer's clock in both. Chromium draws without a graphics card
(SwiftShader), on the cores that everything else uses, too. `make test` installs it. `stages`: of the page's main
thread, by the functions that a sampling profiler finds in it; `CPU` is what the threads got, `wall` counts also when
another program had the core. The worker's decoding is in `client_decode.py`.
"""

from __future__ import annotations

import argparse
import contextlib
import gzip
import itertools
import os
import threading
import time
import tty
from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np
from client_decode import N_X, N_Y, field_message, frames_of, make_values
from playwright.sync_api import CDPSession, Page, sync_playwright

from ruffini.view.guided import serving
from ruffini.view.line import SharedLine
from ruffini.view.server import page_folder
from ruffini.wire import Decoder, Schema, encode_message

CHROMIUM = "/usr/bin/chromium-headless-shell"
SOFTWARE_GL = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
NO_GL = ["--no-sandbox", "--disable-gpu", "--disable-software-rasterizer"]  # the page does without three dimensions
STEP_NM = 600_000
PROFILE_US = 200
STAGES = {  # the methods whose names a bundle keeps
    "numbers and tables": ("writeTexts", "showLine", "showStatus", "showBadges"),
    "maps": ("showField", "showDepth", "showResidual", "showImage"),
    "charts": ("drawStrips", "add"),
    "3-D: geometry": ("moveField", "showWrench", "showContacts"),
    "3-D: drawing, or its commands": ("drawScene",),
    "messages": ("tell", "hear", "worker.onmessage"),
    "idle": ("(idle)",),
    "garbage": ("(garbage collector)",),
    "the browser's own: style, paint, commit": ("(program)",),
}
WARM = 20  # fields: then its shaders are compiled
DELAY_HZ, FULL_HZ = 30.0, 240.0  # of the device, where the delay is measured, and where the page draws all that it can
# The page publishes its state when it has drawn: note when, and which field that was.
HOOK = """
window.__drawn = [];
Object.defineProperty(window, "__state", {
  set(state) {
    this.__kept = state;
    const field = state.lines[0]?.sensors[0]?.field;
    if (field) window.__drawn.push([field.frame, performance.timeOrigin + performance.now()]);
  },
  get() { return this.__kept; },
});
"""


class Device:
    """The other end of a pty: answers, and writes a frame each period from when it is asked to."""

    def __init__(self, rate_hz: float) -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.port, self.rate_hz = os.ttyname(self._slave), rate_hz
        self.written_ms: dict[int, float] = {}  # by frame, since 1970
        self._schema, self._stop, self._wanted = Schema.own(), threading.Event(), threading.Event()
        self._threads = [threading.Thread(target=work, daemon=True) for work in (self._answer, self._stream)]

    def __enter__(self) -> Device:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()

    def _say(self, name: str, message: Any) -> None:
        data = encode_message(
            self._schema.type_numbers[name], message.SerializeToString(), sensor=255, sequence=0, flags=0
        )
        os.write(self._master, data)

    def _answer(self) -> None:
        decoder, schema = Decoder(from_host=True), self._schema
        sensor = {"board": "bench", "product": "a pad of 1,209 nodes", "grid_n_x": N_X, "grid_n_y": N_Y,
                  "grid_origin_x_nm": -(N_X // 2) * STEP_NM, "grid_origin_y_nm": -(N_Y // 2) * STEP_NM,
                  "grid_step_x_nm": STEP_NM, "grid_step_y_nm": STEP_NM, "stages": ["operator"]}  # fmt: skip
        hello = schema.new("Hello", protocol_version=1, schema_sha256=schema.sha256, sensors=[sensor])
        while not self._stop.is_set():
            for frame in decoder.feed(os.read(self._master, 65_536)):
                name = schema.type_name(frame.type)
                if name == "HELLO":
                    self._say("HELLO", hello)
                elif name == "COMMAND":
                    command: Any = schema.decode(frame.type, frame.payload)
                    self._say("REPLY", schema.new("Reply", request_id=command.request_id))
                    self._wanted.set()

    def _stream(self) -> None:
        """Two fields in turn, so that each is drawn again."""
        fields = [field_message(self._schema, tuple(v * k for v in make_values(True))) for k in (1, 2)]
        turns = zip(*(frames_of(self._schema, field) for field in fields), strict=True)
        self._wanted.wait()
        due = time.monotonic()
        for number, pair in enumerate(turns, 1):
            if self._stop.is_set():
                return
            due = max(due + 1 / self.rate_hz, time.monotonic() - 0.1)
            time.sleep(max(due - time.monotonic(), 0))
            self.written_ms[number] = time.time() * 1e3
            os.write(self._master, pair[number % 2])


@contextlib.contextmanager
def shown(rate_hz: float, arguments: list[str], query: str = "") -> Iterator[tuple[Device, Page]]:
    """The page on such a device, warm."""
    addresses = list[str]()
    with Device(rate_hz) as device, serving([SharedLine(device.port)], 0, addresses.append), sync_playwright() as p:
        browser = p.chromium.launch(executable_path=CHROMIUM, args=arguments)
        page = browser.new_page(viewport={"width": 1200, "height": 900})
        page.set_default_timeout(120_000)
        page.add_init_script(HOOK)
        page.goto(addresses[0] + query)
        while page.evaluate("window.__drawn.length") < WARM:
            page.wait_for_timeout(100)
        yield device, page
        browser.close()


def drawn_in(page: Page, seconds: float) -> list[list[float]]:
    """Frame and time of each field that is drawn in so many seconds."""
    page.evaluate("window.__drawn.length = 0")
    page.wait_for_timeout(1e3 * seconds)
    found: list[list[float]] = page.evaluate("window.__drawn")
    return [first for _, (first, *_) in itertools.groupby(found, lambda at: at[0])]  # it publishes more than fields


def metrics(session: CDPSession) -> dict[str, float]:
    """Seconds of the main thread so far: all of it, script, style, layout."""
    return {each["name"]: each["value"] for each in session.send("Performance.getMetrics")["metrics"]}


def stages_of(profile: dict[str, Any]) -> Counter[str]:
    """Milliseconds by stage: the innermost function of one on the stack."""
    stage_by_name = {name: stage for stage, names in STAGES.items() for name in names}
    nodes = {node["id"]: node for node in profile["nodes"]}
    parent = {child: node["id"] for node in profile["nodes"] for child in node.get("children", [])}

    def stage_of(node: int | None) -> str:
        while node is not None:
            name = nodes[node]["callFrame"]["functionName"]
            found = stage_by_name.get(name) or stage_by_name.get(name.partition(".")[2])
            if found:
                return found
            node = parent.get(node)
        return "the rest of the page"

    out = Counter[str]()
    for node, took_us in zip(profile["samples"], profile["timeDeltas"], strict=True):
        out[stage_of(node)] += took_us * 1e-3
    return out


def print_costs(device: Device, page: Page, seconds: float) -> None:
    """Fields drawn a second, and what each costs the page's main thread."""
    session = page.context.new_cdp_session(page)
    session.send("Performance.enable", {"timeDomain": "threadTicks"})
    before, n_written = metrics(session), len(device.written_ms)
    n_drawn = len(drawn_in(page, seconds))
    after, rate = metrics(session), (len(device.written_ms) - n_written) / seconds
    cost = {name: 1e3 * (after[name] - before[name]) / n_drawn for name in before}
    print(f"  {rate:.0f} fields/s come, {n_drawn / seconds:.1f} drawn/s; CPU of the main thread for each "
          f"{cost['TaskDuration']:.2f} ms: script {cost['ScriptDuration']:.2f}, style and layout "
          f"{cost['RecalcStyleDuration'] + cost['LayoutDuration']:.2f}")  # fmt: skip
    session.send("Profiler.enable")
    session.send("Profiler.setSamplingInterval", {"interval": PROFILE_US})
    session.send("Profiler.start")
    n_drawn = len(drawn_in(page, seconds))
    stages = stages_of(session.send("Profiler.stop")["profile"])
    print("  stages, wall ms: " + ", ".join(f"{stage} {ms / n_drawn:.2f}" for stage, ms in stages.most_common()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20)
    seconds = parser.parse_args().seconds
    files = [path for path in page_folder().iterdir() if path.is_file()]
    weight = sum(len(gzip.compress(path.read_bytes(), 9)) for path in files)
    print(f"{weight / 1e3:.0f} kB gzip, all files; {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}; software GL")
    with shown(DELAY_HZ, SOFTWARE_GL) as (device, page):
        first = page.evaluate("window.__state.lines[0].firstFrameMs")
        drawn = drawn_in(page, seconds)
        delay = np.percentile([at - device.written_ms[int(frame)] for frame, at in drawn], [50, 99])
        print(f"first frame {first:.0f} ms after the line was opened")
        print(f"{DELAY_HZ:.0f} fields/s: {len(drawn) / seconds:.1f} drawn/s, pty to page p50 {delay[0]:.0f} ms, "
              f"p99 {delay[1]:.0f} ms, {len(drawn)} frames")  # fmt: skip
    for arguments, query, what in (
        (NO_GL, "", "no WebGL: the page draws the three dimensions itself"),
        (SOFTWARE_GL, "", "SwiftShader for all that the browser puts together, but not for the three dimensions"),
        (SOFTWARE_GL, "?draw=webgl", "SwiftShader for all, also for the three dimensions"),
    ):
        print(what)
        with shown(FULL_HZ, arguments, query) as (device, page):
            print_costs(device, page, seconds)


if __name__ == "__main__":
    main()
