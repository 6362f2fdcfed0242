"""Everything measured on recordings of real sensors, as one table of rows and one page.

Each kind of recording has one function in `KINDS`, which reads its folder and returns its rows; videos of pressed
objects have a mapping file in the folder of their board (`kinds_of_boards`).
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

from ruffini.boards import board_names, boards_folder, find_board
from ruffini.boards.pictures import picture_board
from ruffini.calibrate import container
from ruffini.calibrate.log.columns import Columns, read_column_logs
from ruffini.calibrate.log.videos import VideoColumns
from ruffini.calibrate.report.html import Page
from ruffini.errors import InputError
from ruffini.estimators.photometric.fitted import fit_presses
from ruffini.estimators.photometric.presses import PressSet, load_presses, reference_images
from ruffini.estimators.wrench.model import AXES
from ruffini.evaluate import photometric, pressed_videos, wrench
from ruffini.evaluate.pictures import press_depths

Progress = Callable[[float], None]
MARKER_FORCE = Columns("vision/timestamp", ("vision/dxyz",), "mm", ("force/values",), ("N", "N m"), "force/segment_id")

BALL_MM, PX_PER_MM = 4.70, 19.58  # of gelsight-ball-presses
STANDOFF_MM = 500.0  # hardly any perspective: that camera's lens is not known


class Row(NamedTuple):
    """One figure: of which recordings, in which unit, ours, and peers in the same run."""

    recordings: str
    figure: str
    unit: str
    ours: float
    peers: dict[str, float]


Kind = Callable[[Path, Page, Progress], list[Row]]
MAPPING = ".videos.toml"


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


def ball_presses(folder: Path, page: Page, progress: Progress) -> list[Row]:
    """Colours to slopes: fitted on one half of the presses, judged on the other half's circles as marked by hand."""
    marked = load_presses(folder, ball_mm=BALL_MM, px_per_mm=PX_PER_MM)
    page.heading("gelsight-ball-presses: slopes against a ball of known size")
    page.text("Presses that the table was not fitted on, inside 0.85 of the contact circle, by the board's integers.")
    medians, worst, n_found = dict[str, list[float]](), dict[str, list[float]](), 0
    for half in (0, 1):
        judged = replace(marked, presses=marked.presses[1 - half :: 2])
        given = replace(marked, presses=marked.presses[half::2])
        found = _unmarked(given)
        n_found += len(found.presses)
        for name, presses in (("given", given), ("found", found)):
            result, surfaces = _judged(presses, judged)
            medians.setdefault(name, []).append(result["marked"]["normal_median_deg"])
            worst.setdefault(name, []).append(result["marked"]["normal_worst_deg"])
            if name == "found":
                page.picture(press_depths(judged, surfaces, result), f"depth of presses, half {1 - half}")
            progress((2 * half + (name == "found") + 1) / 4)
    counted = f"presses found without marks, of {len(marked.presses)}"
    rows = [Row("gelsight-ball-presses", counted, "", float(n_found), {})]
    for name in ("given", "found"):
        mean = sum(medians[name]) / 2
        rows.append(Row("gelsight-ball-presses", f"normals, circles {name}: median press", "degrees", mean, {}))
        rows.append(Row("gelsight-ball-presses", f"normals, circles {name}: worst", "degrees", max(worst[name]), {}))
    return rows


def _unmarked(presses: PressSet) -> PressSet:
    """The same pictures, with circles that are found."""
    with tempfile.TemporaryDirectory() as name:
        alone = Path(name)
        for path in (*reference_images(presses.presses[0].path.parents[1]), *(p.path for p in presses.presses)):
            (alone / path.name).symlink_to(path.resolve())
        found = load_presses(alone, ball_mm=presses.ball_mm, px_per_mm=presses.px_per_mm, may_find=True)
    original = {p.path.name: p.path for p in presses.presses}
    return replace(found, presses=[replace(p, path=original[p.path.name]) for p in found.presses])


def _judged(fitted: PressSet, judged: PressSet) -> tuple[dict[str, Any], list[photometric.Surface]]:
    stages = ["difference", "photometric", "poisson"]
    board = picture_board(judged.reference.shape, PX_PER_MM, stages, standoff_mm=STANDOFF_MM)
    fit = fit_presses(fitted, board, is_foreign=True)
    file = container.pack(fit.tensors, {**container.base_metadata(board), **fit.metadata})
    return photometric.evaluate(judged, file, board, [], [])


def pressed_objects(mapping: Path, folder: Path, page: Page, progress: Progress) -> list[Row]:
    """Force along a board's normal beside a load cell, for objects that were not fitted.

    mapping : columns of the recordings, in the folder of the board that took them.
    """
    board, columns, name = find_board(mapping.parent), VideoColumns.read(mapping), folder.name
    found = pressed_videos.evaluate(folder, board, columns, peers=wrench.has_peers(), progress=progress)
    page.heading(f"{name}: board {board.name} against a load cell")
    page.text("The board's integers on every recording of an object that its fit did not see, over the load cell.")
    for line in found.remarks:
        page.text(line)
    page.picture(pressed_videos.picture(found), "force of the board and of the load cell, each object left out")
    ours, peers = found.errors(), {"ridge of 60 components": found.errors("peer")} if found.has_peer else {}

    def row(figure: str, of: Callable[[dict[str, float]], float]) -> Row:
        return Row(name, f"MAE Fz, {figure}", "N", of(ours), {peer: of(errors) for peer, errors in peers.items()})

    rows = [row("mean over objects left out", lambda e: sum(e.values()) / len(e))]
    rows.append(row("worst object", lambda e: max(e.values())))
    rows += [row(f"{left_out} left out", itemgetter(left_out)) for left_out in ours]
    for n, word in ((1, "one stated sigma"), (2, "two")):
        rows.append(Row(name, f"truths within {word}", "%", 100 * found.within(n), {}))
        part = 100 * found.within_of_touched(n)
        rows.append(Row(name, f"truths within {word}, of frames that state a force", "%", part, {}))
    rows.append(Row(name, "mean magnitude of Fz in the first second, untouched", "N", found.at_rest(), {}))
    if hidden := sorted(found.hidden()):
        what = "load cell on frames that state no force"
        rows.append(Row(name, f"{what}: 99th percentile", "N", hidden[int(0.99 * (len(hidden) - 1))], {}))
        rows.append(Row(name, f"{what}: largest", "N", hidden[-1], {}))
    for force, pairs in found.pairs.items():
        rows += _softness(name, f"softness with the force of {force}", pairs)
        page.table(["softer", "harder", f"by the force of {force}", "chance of being wrong"],
                   [[p.softer, p.harder, _verdict(p), f"{p.chance:.4f}"] for p in pairs])  # fmt: skip
    return rows


def _softness(name: str, what: str, pairs: list[pressed_videos.Pair]) -> list[Row]:
    """Which of two like objects is harder, neither of them fitted: counts, and the stated chances."""
    told = [pair for pair in pairs if pair.is_told]
    counts = {"distinguished rightly": sum(p.is_right for p in told), "not distinguished": len(pairs) - len(told),
              "distinguished wrongly": sum(not p.is_right for p in told)}  # fmt: skip
    rows = [Row(name, f"{what}: pairs {words}", f"of {len(pairs)}", float(n), {}) for words, n in counts.items()]
    singles = [a.log < b.log for p in pairs for a in p.shares[0] for b in p.shares[1]]
    rows.append(Row(name, f"{what}: single squeezes in the right order", f"of {len(singles)}", float(sum(singles)), {}))
    largest = 100 * max(pair.chance for pair in pairs)
    return [*rows, Row(name, f"{what}: largest stated chance of being wrong", "%", largest, {})]


def _verdict(pair: pressed_videos.Pair) -> str:
    if not pair.is_told:
        return "cannot tell"
    return "right" if pair.is_right else "wrong"


def kinds_of_boards() -> dict[str, Kind]:
    """Recordings of pressed objects, by folder: those for which a board has a mapping file `FOLDER.videos.toml`."""
    mappings = sorted(path for name in board_names() for path in (boards_folder() / name).glob(f"*{MAPPING}"))
    return {path.name.removesuffix(MAPPING): partial(pressed_objects, path) for path in mappings}


KINDS: dict[str, Kind] = {
    "marker-force": marker_force,
    "gelsight-ball-presses": ball_presses,
}


def evaluate(folder: Path, out: Path, progress: Progress = lambda _: None) -> list[Row]:
    """Rows of all kinds of recordings in a folder; writes the page.

    Raises
    ------
    InputError
        There are none.
    """
    known = KINDS | kinds_of_boards()
    kinds = [name for name in known if (folder / name).is_dir()]
    if not kinds:
        raise InputError(f"{folder}: holds none of {', '.join(known)}: name the folder of recordings, or judge a "
                         "log of your own with `ruffini eval wrench`")  # fmt: skip
    page, rows = Page("ruffini on recordings of real sensors"), list[Row]()
    for name in kinds:
        rows += known[name](folder / name, page, progress)
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
        cells = (cell if isinstance(cell, str) else f"{cell:.3g}" for cell in _cells(row, peers))
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
