"""Everything measured on recordings of real sensors, as one table of rows and one page.

Each kind of recording has one function in `KINDS`, which reads its folder and returns its rows.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from ruffini.calibrate.column_log import Columns, read_column_logs
from ruffini.calibrate.html_page import Page
from ruffini.calibrate.wrench_model import AXES
from ruffini.errors import InputError
from ruffini.evaluate import wrench

Progress = Callable[[float], None]
MARKER_FORCE = Columns("vision/timestamp", ("vision/dxyz",), "mm", ("force/values",), ("N", "N m"), "force/segment_id")


class Row(NamedTuple):
    """One figure: of which recordings, in which unit, ours, and peers in the same run."""

    recordings: str
    figure: str
    unit: str
    ours: float
    peers: dict[str, float]


def marker_force(folder: Path, page: Page, progress: Progress) -> list[Row]:
    """Wrench of followed markers beside a six-axis force/torque sensor."""
    logs = read_column_logs([folder], MARKER_FORCE)
    found = wrench.evaluate(logs, peers=wrench.has_peers(), progress=progress)
    flagged = wrench.beyond(logs)
    page.heading("marker-force: measured against a force/torque sensor")
    page.text("The board's integers on frames that its fit did not see, over what the sensor measured.")
    rows = []
    for each in found:
        page.picture(_scatter(each), f"wrench of the board over the sensor's, {each.name}")
        for i, axis in enumerate(AXES):
            peers = {name: float(mae[i]) for name, mae in each.mae.items() if name != "board"}
            unit = "N" if i < 3 else "N mm"
            rows.append(Row("marker-force", f"{each.name}: MAE {axis}", unit, float(each.mae["board"][i]), peers))
        for n, word in ((1, "one stated sigma"), (2, "two")):
            rows.append(Row("marker-force", f"{each.name}: within {word}", "%", 100 * each.within(n), {}))
    rows.append(Row("marker-force", "frames beyond every fitted load that are flagged", "%", 100 * flagged, {}))
    return rows


KINDS: dict[str, Callable[[Path, Page, Progress], list[Row]]] = {"marker-force": marker_force}


def evaluate(folder: Path, out: Path, progress: Progress = lambda _: None) -> list[Row]:
    """Rows of all kinds of recordings in a folder; writes the page.

    Raises
    ------
    InputError
        There are none.
    """
    kinds = [name for name in KINDS if (folder / name).is_dir()]
    if not kinds:
        raise InputError(f"{folder}: holds none of {', '.join(KINDS)}: name the folder of recordings, or judge a "
                         "log of your own with `ruffini eval wrench`")  # fmt: skip
    page, rows = Page("ruffini on recordings of real sensors"), list[Row]()
    for name in kinds:
        rows += KINDS[name](folder / name, page, progress)
    page.heading("Table")
    page.table(["recordings", "figure", "unit", "ruffini", *_peers(rows)], [_cells(row, _peers(rows)) for row in rows])
    out.parent.mkdir(parents=True, exist_ok=True)
    page.write(out)
    return rows


def table(rows: list[Row]) -> str:
    """As Markdown."""
    peers = _peers(rows)
    lines = [f"| recordings | figure | unit | ruffini | {' | '.join(peers)} |", "| --- " * (4 + len(peers)) + "|"]
    for row in rows:
        cells = (f"{cell:.3g}" if isinstance(cell, float) else cell for cell in _cells(row, peers))
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _peers(rows: list[Row]) -> list[str]:
    return list(dict.fromkeys(name for row in rows for name in row.peers))


def _cells(row: Row, peers: list[str]) -> list[str | float]:
    return [row.recordings, row.figure, row.unit, row.ours, *(row.peers.get(name, "") for name in peers)]


def _scatter(found: wrench.Protocol) -> object:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 6.5), layout="constrained")
    for i, (axis, axes) in enumerate(zip(AXES, figure.subplots(2, 3).ravel(), strict=True)):
        flagged = found.board.flagged
        for mask, colour, label in ((~flagged, "#2f6fab", "in range"), (flagged, "#c05020", "flagged")):
            axes.plot(found.truth[mask, i], found.board.wrench[mask, i], ".", ms=2, color=colour, label=label)
        ends = [found.truth[:, i].min(), found.truth[:, i].max()]
        axes.plot(ends, ends, "k-", lw=0.7)
        unit = "N" if i < 3 else "N mm"
        axes.set_title(f"{axis}, MAE {found.mae['board'][i]:.3g} {unit}", fontsize=10)
        axes.set_xlabel(f"sensor, {unit}")
        axes.set_ylabel(f"board, {unit}")
    figure.axes[0].legend(fontsize=8, markerscale=4)
    figure.suptitle(found.name)
    return figure
