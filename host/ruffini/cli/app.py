"""The tree of commands: one line per verb, in the groups of the help."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable, Mapping
from typing import Any

import typer

from ruffini.cli import (
    auto,
    bench,
    board,
    cal,
    check,
    collect,
    demo,
    design,
    device,
    doctor,
    eeprom,
    evaluate,
    fit,
    flash,
    fleet,
    key,
    latency,
    live,
    monitor,
    offline,
    recording,
    report,
    reproduce,
    rerun,
    ros2,
    sim,
    train,
    udev,
    validate,
    view,
)
from ruffini.cli.one_of import register
from ruffini.estimators.commands import COMMANDS

USE, CALIBRATE, JUDGE, SIMULATE, MAINTAIN = ("Use", "Calibrate", "Judge", "Simulate", "Maintain")
Function = Callable[..., None]


def _add(group: typer.Typer, verbs: Mapping[str, Function], panel: str | None = None) -> None:
    for name, function in verbs.items():
        group.command(name, rich_help_panel=panel)(function)


def told(old: str, new: str, function: Function) -> Function:
    """`function` under the name of the release before: it prints the new one on stderr first."""

    @functools.wraps(function)
    def run(*args: Any, **values: Any) -> None:
        print(f"ruffini: `{old}` is now `ruffini {new}`", file=sys.stderr)
        function(*args, **values)

    return run


app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Newtons from a camera that looks at a soft pad: simulate, calibrate, flash, record, show.",
    epilog="Exit codes: 0 ok, 1 failed check, 2 usage or bad input, 3 no device, 4 refused, 5 verify failed, "
    "130 interrupted.",
)
app.callback()(device.common_options)
_add(
    app,
    {
        "devices": device.devices,
        "info": device.info,
        "monitor": monitor.monitor,
        "view": view.view,
        "live": live.live,
        "snapshot": device.snapshot,
        "record": device.record,
        "replay": recording.replay,
        "export": recording.export,
        "plot": recording.plot,
        "recover": recording.recover,
        "rerun": rerun.rerun,
        "latency": latency.latency,
    },
    panel=USE,
)
register(
    app, "ros2", "The stream in ROS 2.", {"bridge": ros2.bridge, "urdf": ros2.urdf, "messages": ros2.messages},
    rich_help_panel=USE,
)  # fmt: skip

calibration = typer.Typer(no_args_is_help=True, help="Calibrate a sensor: collect, fit, judge, flash.")
_add(calibration, {"auto": auto.auto, "collect": collect.collect, "convert": collect.convert})
calibration.command("fit", cls=fit.Fit)(fit.verb())
_add(
    calibration,
    {
        "report": report.report,
        "check": check.check,
        "flash": flash.flash,
        "undo": flash.undo,
        "zero": cal.zero,
        "fleet": fleet.fleet,
    },
)
register(calibration, "file", "Calibration files.", {"show": cal.show, "verify": cal.verify, "merge": cal.merge})
app.add_typer(calibration, name="cal", rich_help_panel=CALIBRATE)

register(
    app, "eval", "Judge on your own recordings.",
    {"markers": evaluate.markers, "wrench": evaluate.wrench, "real": evaluate.real,
     "photometric": evaluate.photometric, "flow": evaluate.flow},
    rich_help_panel=JUDGE,
)  # fmt: skip
register(
    app, "bench", "Judge on the digital twin.",
    {"ifem": bench.ifem, "slip": bench.slip, "held": bench.held, "touch": bench.touch, "light": bench.light,
     "health": bench.health, "presses": bench.presses, "rig": bench.rig, "auto": bench.auto, "fleet": bench.fleet,
     "mechanics": validate.validate, "twin": sim.bench},
    {"papers": told("bench papers", "reproduce BOARD --only method", reproduce.papers_of_bench)},
    rich_help_panel=JUDGE,
)  # fmt: skip
register(
    app, "offline", "The device's arithmetic on pictures and tables.",
    {"track": offline.track, "depth": offline.depth, "field": offline.field},
    rich_help_panel=JUDGE,
)  # fmt: skip
app.command("reproduce", rich_help_panel=JUDGE)(reproduce.reproduce)

twin = typer.Typer(no_args_is_help=True, help="The digital twin: simulated recordings with their truth.")
_add(twin, {"press": sim.press, "dataset": sim.dataset, "serve": sim.serve, "design": design.design})
app.add_typer(twin, name="sim", rich_help_panel=SIMULATE)
app.command("demo", rich_help_panel=SIMULATE)(demo.demo)

app.command("doctor", rich_help_panel=MAINTAIN)(doctor.doctor)
register(
    app, "board", "Board folders, and the EEPROMs that name a board or a gel.",
    {"check": board.check, "show": board.show, "list": board.list_, "eeprom": eeprom.eeprom},
    rich_help_panel=MAINTAIN,
)  # fmt: skip
register(
    app, "key", "Owners' signing keys: a sensor with an enrolled one takes that owner's files only.",
    {"new": key.new, "show": key.show, "enrol": key.enrol, "sign": key.sign},
    rich_help_panel=MAINTAIN,
)  # fmt: skip
register(
    app, "udev", "This computer's rules for sensors on USB.", {"install": udev.install, "show": udev.show},
    rich_help_panel=MAINTAIN,
)  # fmt: skip
networks = typer.Typer(no_args_is_help=True, help="Train networks on the digital twin (needs PyTorch).")
_add(networks, {"displacement": train.displacement, "stereo": train.stereo})
app.add_typer(networks, name="train", rich_help_panel=MAINTAIN)


def _renamed(group: typer.Typer, verbs: Mapping[str, Function], old: str, new: str) -> None:
    """Names of the release before, which help does not show; {} stands for each."""
    for name, function in verbs.items():
        group.command(name, hidden=True)(told(old.format(name), new.format(name), function))


for one in COMMANDS:
    calibration.command(one.former_verb, hidden=True, cls=fit.OldFit)(fit.verb())
_renamed(calibration, {"show": cal.show, "verify": cal.verify, "merge": cal.merge}, "cal {}", "cal file {}")
_renamed(app, {"track": offline.track, "depth": offline.depth, "field": offline.field}, "{}", "offline {}")
_renamed(twin, {"validate": validate.validate}, "sim {}", "bench mechanics")
_renamed(twin, {"bench": sim.bench}, "sim {}", "bench twin")
_renamed(twin, {"reproduce": reproduce.sim_reproduce}, "sim {}", "reproduce BOARD --only recordings")


@functools.cache
def command() -> Any:
    """The whole tree as a click command; to build it takes longer than most verbs take to refuse."""
    return typer.main.get_command(app)
