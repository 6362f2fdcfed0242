"""The dense pad beside a sparse one, in turn on one core: time of a frame, calibration, memory. SIMULATED.

    python tests/bench/dense_pad.py --table docs/results/accuracy.md

Both at 640x480 with pictures of benchmarks.py. Milliseconds are medians of runs that alternate, since a machine's
memory is not equally fast at all times: their ratio is what counts. Resident memory: with everything subscribed,
pressed, after a start with a flashed calibration.
"""

from __future__ import annotations

import argparse
import datetime
import re
import socket
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt
from benchmarks import make_data, run_kernels, seventy_markers, solve_tensors
from gels import with_row

from ruffini.boards import Board, find_board
from ruffini.daemon import started_daemon
from ruffini.device import Connection
from ruffini.files import write_whole
from ruffini.frame_server import FrameServer

sys.path.append(str(Path(__file__).parents[1] / "hostile"))
from table import commit

SECTION = "## The dense pad"
COLUMNS = ("pad", "markers", "nodes, touched", "frame, ms", "median ratio of pairs", "calibration, MB", "resident, MiB",
           "commit", "date")  # fmt: skip
JUDGED = ("firmware", "host/ruffini", "boards", "tests/bench/dense_pad.py", "tests/bench/benchmarks.py", ":!*.md")
EVERYTHING = {"wrench": 1, "field": 1, "depth": 1, "contacts": 1, "markers": 1, "image": 1}
N_RUNS = 5
N_FRAMES = 60
TIMEOUT_S = 300.0


class Pictures(FrameServer):
    """The untouched picture until rest is learned, then the pressed one; each with a little noise of its own."""

    def __init__(self, board: Board, path: Path, folder: Path) -> None:
        super().__init__(board, path, magic=b"RFTC", rate_mhz=board.camera.rate_mhz)
        shape = (board.camera.height_px, board.camera.width_px, 3)
        self._pictures = [np.fromfile(folder / f"{n}.bgr", np.uint8).reshape(shape) for n in ("rest", "pressed")]
        self._n_rest = 3 * board.pipeline.n_rest_frames

    def _stream(self, camera: socket.socket, *, is_paced: bool) -> None:
        assert not is_paced
        frame, noise = 0, np.random.default_rng(1)
        while not self._stop.is_set():
            picture = self._pictures[frame >= self._n_rest]
            speck: npt.NDArray[np.uint8] = noise.integers(0, 2, picture.shape, np.uint8)
            self._send_frame(camera, frame, np.maximum(picture, speck).tobytes())
            frame += 1


@dataclass
class Pad:
    """A board, its folder of inputs, and what was measured so far."""

    name: str
    board: Board
    folder: Path
    frame_ms: list[float] = field(default_factory=list)
    n_touched: int = 0


def resident_mib(pad: Pad) -> float:
    """What ruffinid holds of the machine's memory, pressed, with everything subscribed."""
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "twin"
        run = (pad.folder, f"twin:{path}", Path(scratch) / "store", "--lockstep", "--wait-for-host")
        with Pictures(pad.board, path, pad.folder):
            with started_daemon(*run) as daemon, Connection(daemon.port) as host:
                host.flash((pad.folder / "calibration.safetensors").read_bytes())
            with started_daemon(*run) as daemon, Connection(daemon.port) as host:
                host.subscribe(**EVERYTHING)
                n = 4 * pad.board.pipeline.n_rest_frames + N_FRAMES
                for frame, _ in host.stream(timeout_s=TIMEOUT_S):
                    n -= host.schema.type_name(frame.type) == "WRENCH"
                    if n == 0:
                        break
                status = Path(f"/proc/{daemon.pid}/status").read_text()
    found = re.search(r"VmRSS:\s*(\d+) kB", status)
    assert found is not None
    return int(found[1]) / 1024


def row(pad: Pad, sparse: Pad, at: str) -> str:
    """Of the table."""
    n_markers = pad.board.markers.n_x * pad.board.markers.n_y
    rows, columns = pad.board.observed
    n_nodes = (rows.stop - rows.start) * (columns.stop - columns.start)
    ratio = np.median([own / other for own, other in zip(pad.frame_ms, sparse.frame_ms, strict=True)])
    size = (pad.folder / "calibration.safetensors").stat().st_size
    cells = (
        pad.name, f"{n_markers:,}", f"{n_nodes:,}, {pad.n_touched}", f"{np.median(pad.frame_ms):.1f}", f"{ratio:.2f}",
        f"{size / 1e6:.1f}", f"{resident_mib(pad):.1f}", at, datetime.date.today().isoformat(),
    )  # fmt: skip
    return f"| {' | '.join(cells)} |"


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--build", type=Path, default=Path("build"))
    parser.add_argument("--table", type=Path, metavar="FILE", help="write the rows into this document")
    given = parser.parse_args(words)
    at = commit(JUDGED)
    pads = []
    for name, board in (("70 markers", seventy_markers(640)), ("gelslim-dense", find_board("gelslim-dense"))):
        print(f"dense_pad: making the calibration of {name}", file=sys.stderr, flush=True)
        pads.append(Pad(name, board, given.build / "bench" / name.replace(" ", "-") / board.name))
        make_data(board, pads[-1].folder, solve_tensors(board))
    for _ in range(N_RUNS):
        for pad in pads:
            frame = run_kernels(given.build / "ruffini_bench", pad.folder, only="frame")["frame"]
            pad.frame_ms.append(frame["cpu_time"] / 1e6)
            pad.n_touched = round(frame["touched_nodes"])
    for pad in pads:
        line = row(pad, pads[0], at)
        print(line, flush=True)
        if given.table is not None:
            write_whole(given.table, with_row(given.table.read_text(), line, SECTION, COLUMNS).encode())
    return 0


if __name__ == "__main__":
    sys.exit(main())
