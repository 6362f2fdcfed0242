"""Hostile ends of a recording: a daemon that is killed or stopped, a full medium; and requests to the viewer."""

from __future__ import annotations

import asyncio
import random
import re
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / "tests" / folder) for folder in ("support", "e2e", "hostile", "py/view")]

from cases import LIMIT_S, group  # noqa: E402
from stores_devices import sensor  # noqa: E402

RECORD = "import sys; from ruffini.cli import main; sys.exit(main())"
SAVED = re.compile(r"\(after (\d+) frames|(\d+) frames are saved")


def _said(process: subprocess.Popen[str], code: int, path: Path, *, is_cut: bool = False) -> None:
    """`record` ends with this code and one sentence, which names the file and how many frames it holds."""
    from ruffini.record import Recording

    _, err = process.communicate(timeout=LIMIT_S)
    assert process.returncode == code, f"exit code {process.returncode}: {err[-300:]}"
    assert "Traceback" not in err, err
    said = next(line for line in err.splitlines() if line.startswith("ruffini: "))
    found = SAVED.search(said)
    assert found is not None, said
    assert path.name in said, said
    n = int(found[1] or found[2])
    read = Recording(path)
    held = sum(1 for _ in read.frames(partial=True))
    assert held >= n, f"{n} said, {held} held"
    assert is_cut or not read.problems, read.problems


def _record(port: str, path: Path, chance: random.Random, most_bytes: int = 0) -> subprocess.Popen[str]:
    words = [sys.executable, "-c", RECORD, "--port", port, "record", str(path)]
    words += chance.choice([[], ["--n", "1000000"]])
    limits = (lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, most_bytes))) if most_bytes else None
    return subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=limits)


@group("record: the daemon is killed or stopped", 12, 2)
def _killed(chance: random.Random, folder: Path) -> None:
    from tiny_sensor import start

    path = folder / "a.mcap"
    with start(sensor(), folder / "store", "--loop") as daemon, _record(daemon.port, path, chance) as process:
        wanted, end = chance.randrange(2_000, 200_000), time.monotonic() + LIMIT_S
        while (not path.exists() or path.stat().st_size < wanted) and time.monotonic() < end:
            assert process.poll() is None, process.stderr and process.stderr.read()
            time.sleep(0.01)
        daemon.process.send_signal(chance.choice([signal.SIGKILL, signal.SIGTERM, signal.SIGSTOP, signal.SIGABRT]))
        _said(process, 3, path)


@group("record: the medium is full", 12, 2)
def _full(chance: random.Random, folder: Path) -> None:
    from tiny_sensor import start

    path, most = folder / "a.mcap", chance.randrange(20_000, 400_000)
    with start(sensor(), folder / "store", "--loop") as daemon, _record(daemon.port, path, chance, most) as process:
        _said(process, 2, path, is_cut=True)
    assert path.stat().st_size <= most


@group("view: requests from elsewhere", 40, 6)
def _requests(chance: random.Random, folder: Path) -> None:
    from test_host_header import status_of

    def odd() -> bytes:
        drawn = bytes(chance.choice(b"[]:@/\\%#?.a1 \t\x7f\xff") for _ in range(chance.randrange(1, 30)))
        return chance.choice(
            [b"evil.example", b"127.0.0.1.evil.example", b"[::1", b"localhost@evil", b"[" * 3000, drawn]
        )

    own = b"Host: 127.0.0.1:PORT\r\n"
    fields = chance.choice([b"Host: " + odd() + b"\r\n", own + b"Origin: http://" + odd() + b"\r\n", b""])
    version = chance.choice([b"1.0", b"1.1"])
    status = asyncio.run(status_of(b"GET /lines.json HTTP/" + version + b"\r\n" + fields + b"\r\n"))
    assert status in (400, 403), f"{fields!r}: {status}"
