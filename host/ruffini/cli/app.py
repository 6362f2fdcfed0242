"""The tree of commands: one line per verb or group."""

from __future__ import annotations

import typer

from ruffini.cli import (
    auto,
    bench,
    board,
    cal,
    camera,
    check,
    collect,
    contact,
    dark,
    demo,
    device,
    doctor,
    eeprom,
    evaluate,
    fingertip,
    fit,
    flash,
    fleet,
    key,
    latency,
    monitor,
    offline,
    recording,
    report,
    reproduce,
    rerun,
    ros2,
    sim,
    skin,
    touch,
    train,
    udev,
    view,
    wrench,
)

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Newtons from a camera that looks at a soft pad: simulate, calibrate, flash, record, show.",
    epilog="Exit codes: 0 ok, 1 failed check, 2 usage or bad input, 3 no device, 4 refused, 5 verify failed, "
    "130 interrupted.",
)
app.callback()(device.common_options)
app.command("devices")(device.devices)
app.command("info")(device.info)
app.command("monitor")(monitor.monitor)
app.command("record")(device.record)
app.command("latency")(latency.latency)
app.command("replay")(recording.replay)
app.command("export")(recording.export)
app.command("plot")(recording.plot)
app.command("recover")(recording.recover)
app.command("snapshot")(device.snapshot)
app.command("view")(view.view)
app.command("rerun")(rerun.rerun)
app.command("track")(offline.track)
app.command("depth")(offline.depth)
app.command("field")(offline.field)
cal.app.command("camera")(camera.camera)
cal.app.command("dark")(dark.dark)
cal.app.command("contact")(contact.contact)
cal.app.command("touch")(touch.touch)
cal.app.command("wrench")(wrench.wrench)
cal.app.command("collect")(collect.collect)
cal.app.command("skin")(skin.skin)
cal.app.command("fingertip")(fingertip.fingertip)
cal.app.command("convert")(collect.convert)
cal.app.command("fit")(fit.fit)
cal.app.command("flash")(flash.flash)
cal.app.command("undo")(flash.undo)
cal.app.command("report")(report.report)
cal.app.command("auto")(auto.auto)
cal.app.command("check")(check.check)
cal.app.command("fleet")(fleet.fleet)
app.add_typer(cal.app, name="cal")
app.add_typer(sim.app, name="sim")
app.add_typer(bench.app, name="bench")
app.add_typer(evaluate.app, name="eval")
board.app.add_typer(eeprom.app, name="eeprom")
app.add_typer(board.app, name="board")
app.add_typer(train.app, name="train")
app.add_typer(key.app, name="key")
app.add_typer(ros2.app, name="ros2")
app.add_typer(udev.app, name="udev")
app.command("doctor")(doctor.doctor)
app.command("demo")(demo.demo)
app.command("reproduce")(reproduce.reproduce)
