"""Board files that both parsers must judge alike: good/, bad/, and index.txt with the reason for each.

    python3 tests/data/boards/make_corpus.py [FOLDER]

Each file is base.toml with one thing changed.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

HERE = Path(__file__).parent
Change = Callable[[str], str]


def put(key: str, value: str) -> Change:
    """Another value for a key (keys are unique over the sections of the base, but for those with a section)."""

    def change(text: str) -> str:
        section, _, name = key.rpartition(".")
        lines, inside = text.splitlines(), not section
        for i, line in enumerate(lines):
            if line.startswith("["):
                inside = line == f"[{section}]"
            elif inside and line.split(" = ")[0] == name:
                lines[i] = f"{name} = {value}"
                return "\n".join(lines) + "\n"
        raise SystemExit(f"the base has no {key}")

    return change


def drop(key: str) -> Change:
    def change(text: str) -> str:
        marked = put(key, "<drop>")(text)
        return "".join(line + "\n" for line in marked.splitlines() if not line.endswith("<drop>"))

    return change


def add(section: str, line: str) -> Change:
    return lambda text: text.replace(f"[{section}]\n", f"[{section}]\n{line}\n")


def append(lines: str) -> Change:
    return lambda text: text + lines


TARGETS = """
[targets]
places_um = [[5000, 5000], [9000, 8000]]
below_um = 2000
diameter_um = 3000
threshold_1e3 = 500
"""
EXPOSURE = "[exposure]\ngain_1e3 = 2000\nred_1e3 = 1500\nblue_1e3 = 1700\n"
OF_USB = "[exposure]\ngain_1e3 = 2000\nwhite_kelvin = 5000\n"
EEPROM = '[eeprom]\nbus = "/dev/i2c-1"\naddress_bytes = 2\n'
LIGHT = '[light]\nchip = "gpiochip0"\nline = "LAMPS"\n'
DRIVER = '[led_driver]\nbus = "/dev/i2c-1"\naddress = 21\nresistor_ohm = 1000\nramp_ms = 0\n'
TEMPERATURE = '[temperature]\nplace = "gel"\npath = "/t"\n'
WITHOUT_LIGHT = '["difference", "markers", "displacement", "operator", "support", "wrench", "contacts"]'
WITH_CONTACT_MODEL = '["difference", "markers", "feature_wrench", "contact_model"]'
WITH_TARGETS = '["difference", "targets", "feature_wrench"]'
SKIN = """
[skin]
shape = "tube"
radius_um = 40000
n_panels = 4
mode = "auto"
weight_b = 0
weight_g = 1
weight_r = 0
level = 30
min_area_px = 400
averaged_frames = 3
"""


def all_of(*changes: Change) -> Change:
    def change(text: str) -> str:
        for one in changes:
            text = one(text)
        return text

    return change


def drop_section(name: str) -> Change:
    def change(text: str) -> str:
        kept, inside = [], False
        for line in text.splitlines():
            if line.startswith("["):
                inside = line == f"[{name}]"
            if not inside:
                kept.append(line)
        return "\n".join(kept) + "\n"

    return change


REFLEX = '[reflex]\nchip = "gpiochip0"\nline = "GRIP"\nforce_un = 5000000\nslip = "none"\nwhen_invalid = "on"\n'

GOOD: dict[str, Change] = {
    "base": lambda t: t,
    "comments": lambda t: "# a comment\n" + t.replace("[pad]", "# another\n[pad]  # here"),
    "crlf": lambda t: t.replace("\n", "\r\n"),
    "tabs": lambda t: t.replace(" = ", "\t=\t"),
    "inline-tables": all_of(drop_section("contact"), lambda t: "contact = { threshold_un = 1, min_nodes = 1 }\n" + t),
    "dotted-keys": all_of(drop_section("field"), lambda t: "field.force_lsb_un = 20\n" + t),
    "texture": all_of(
        put("markers.polarity", '"texture"'),
        put("pipeline.stages", '["difference", "markers", "displacement"]'),
    ),
    "gauge-spacing": put("depth.gauge", '"spacing"'),
    "gauge-volume": put("depth.gauge", '"volume"'),
    "gauge-both": put("depth.gauge", '"both"'),
    "depth-from-light": add("depth", 'source = "light"'),
    "depth-from-markers": all_of(add("depth", 'source = "markers"'), put("pipeline.stages", WITHOUT_LIGHT)),
    "scattered": add("markers", 'layout = "scattered"'),
    "scattered-and-listed": all_of(
        add("markers", 'layout = "scattered"\nplaces_um = [[0, 0], [4000, 500], [700, 900], [20000, 16000]]'),
        put("markers.n_x", "2"), put("markers.n_y", "2"),
    ),
    "views": all_of(
        add("markers", 'layout = "views"'), put("markers.n_x", "1024"), put("markers.n_y", "2"),
        put("pipeline.stages", '["difference", "markers"]'),
    ),
    "fingertip": all_of(
        add("markers", 'layout = "views"'), put("markers.n_x", "292"), put("markers.n_y", "2"),
        put("pipeline.stages", '["difference", "markers", "fingertip"]'),
    ),
    "light-markers-of-high-contrast": all_of(
        put("markers.polarity", '"light"'), put("markers.threshold_1e3", "1900")
    ),
    "hexadecimal": put("camera.width_px", "0x140"),
    "underscores": put("pad.modulus_pa", "200_000"),
    "plus-sign": put("grid.n_x", "+31"),
    "literal-string": put("board.name", "'sample'"),
    "quoted-key": put("board.not_measured", '["torque_z"]'),
    "escaped-text": put("board.name", '"\\u0073ample"'),
    "no-final-newline": lambda t: t.rstrip("\n"),
    "skin": all_of(append(SKIN), put("pipeline.stages", '["skin"]')),
    "targets": all_of(append(TARGETS), put("pipeline.stages", WITH_TARGETS)),
    "feature-wrench-of-markers": put("pipeline.stages", '["difference", "markers", "feature_wrench"]'),
    "helmholtz": all_of(
        put("markers.polarity", '"texture"'), put("pipeline.stages", WITH_CONTACT_MODEL[:-1] + ', "helmholtz"]')
    ),
    "contact-depth": all_of(
        put("markers.polarity", '"texture"'), put("pipeline.stages", WITH_CONTACT_MODEL[:-1] + ', "contact_depth"]')
    ),
    "contact-model": all_of(put("markers.polarity", '"texture"'), put("pipeline.stages", WITH_CONTACT_MODEL)),
    "stiffness-sigma": add("pad", "stiffness_sigma_1e3 = 500"),
    "stiffness-known": add("pad", "stiffness_sigma_1e3 = 0"),
    "few-stages": put("pipeline.stages", '["difference", "photometric", "poisson"]'),
    "no-markers": all_of(
        drop_section("markers"), put("pipeline.stages", '["difference", "photometric", "poisson"]')
    ),
    "smallest-window": all_of(
        put("window.min_x_um", "0"), put("window.min_y_um", "0"),
        put("window.max_x_um", "700"), put("window.max_y_um", "700"),
    ),
    "8000-bytes": lambda t: t + "#" * (8_000 - len(t)),
    "lists-at-their-limits": put("board.not_measured", str(["x" * 23] * 8).replace("'", '"')),
    "memory": lambda t: t + "[memory]\ncalibration_kb = 64\n",
    "temperature": append(f'[temperature]\nplace = "gel"\npath = "/{"a" * 127}"\n'),
    "exposure": append(f"{EXPOSURE}time_us = 16666\n"),
    "exposure-of-a-camera-on-usb": append(f"{OF_USB}time_us = 16666\n"),
    "light": append(f'[light]\nchip = "gpiochip0"\nline = "{"L" * 31}"\n'),
    "eeprom": append(f"{EEPROM}board_address = 80\ngel_address = 81\n"),
    "eeprom-of-the-gel": append(f"{EEPROM}gel_address = 119\n"),
    "light-alternates": append(f'{LIGHT}alternation = "lit_dark"\n{EXPOSURE}time_us = 8333\n'),
    "led-driver": append(f"{DRIVER}currents_ua = {[57375] * 16}\n"),
    "led-driver-with-a-limit": append(f"{DRIVER}currents_ua = [0]\nmax_milli_celsius = 150000\n{TEMPERATURE}"),
    "stereo": append("[stereo]\ntolerance_us = 8333\n"),
    "threads": append(
        "[threads]\ncapture_priority = 49\ncapture_cpus = [0, 63]\nframe_priority = 1\nframe_cpus = [1]\n"
        "link_priority = 20\nlink_cpus = [2]\ninference_cpus = [3, 3]\n"
    ),
    "threads-of-one": append("[threads]\nframe_priority = 40\n"),
    "learned": append('[learned]\nnetwork = "net.onnx"\n'),
    "reflex": append(REFLEX),
    "reflex-by-slip": append(REFLEX.replace("5000000", "0").replace('"none"', '"incipient"')),
    "limits": all_of(
        put("pad.poisson_1e4", "4999"), put("grid.n_layers", "32"), put("contact.threshold_un", "100000000")
    ),
}  # fmt: skip

# name: change, a word of the error
BAD: dict[str, tuple[Change, str]] = {
    "empty": (lambda t: "", "schema"),
    "only-comment": (lambda t: "# nothing\n", "schema"),
    "byte-order-mark": (lambda t: "\ufeff" + t, "byte-order mark"),
    "utf-16": (lambda t: "UTF16" + t, "ASCII"),
    "umlaut-in-comment": (lambda t: "# gr\u00fcn\n" + t, "ASCII"),
    "latin-1": (lambda t: "# gr\udcfcn\n" + t, "ASCII"),
    "lone-carriage-return": (lambda t: t.replace("\n", "\r"), "not TOML"),
    "odd-space": (lambda t: t.replace(" = ", " =\u00a0", 1), "ASCII"),
    "zero-byte": (lambda t: t + "\0", "ASCII"),
    "not-toml": (lambda t: "this is not TOML\n", "not TOML"),
    "json": (lambda t: '{"schema": 1}\n', "not TOML"),
    "unclosed-string": (put("board.name", '"sample'), "not TOML"),
    "unclosed-list": (put("pipeline.stages", '["difference"'), "not TOML"),
    "duplicate-key": (add("pad", "size_x_um = 20000"), "not TOML"),
    "duplicate-section": (lambda t: t + "\n[pad]\nsize_x_um = 1\n", "not TOML"),
    "deep-lists": (lambda t: "chain = " + "[" * 2_000 + "]" * 2_000 + "\n" + t, "not TOML"),
    "deep-keys": (lambda t: "chain" + ".a" * 3_000 + " = 1\n" + t, "chain"),
    "integer-65-bits": (put("pad.size_x_um", "18446744073709551616"), ""),
    "integer-64-bits-unsigned": (put("pad.size_x_um", "9223372036854775808"), ""),
    "integer-63-bits": (put("pad.size_x_um", "9223372036854775807"), "size_x_um"),
    "schema-missing": (drop("schema"), "schema"),
    "schema-2": (put("schema", "2"), "schema"),
    "schema-text": (put("schema", '"1"'), "schema"),
    "schema-float": (put("schema", "1.0"), "schema"),
    "schema-bool": (put("schema", "true"), "schema"),
    "unknown-section": (lambda t: t + "\n[optics]\nx = 1\n", "optics"),
    "unknown-key": (add("pad", "hardness = 30"), "hardness"),
    "unknown-key-at-top": (lambda t: "name = 1\n" + t, "name"),
    "misspelt-key": (lambda t: t.replace("thickness_um", "thicknes_um"), "thickness_um"),
    "section-missing": (drop_section("camera"), "camera"),
    "section-is-a-number": (all_of(drop_section("field"), lambda t: "field = 1\n" + t), "field"),
    "section-is-a-list": (lambda t: t.replace("[field]", "[[field]]"), "field"),
    "stiffness-sigma-of-all": (add("pad", "stiffness_sigma_1e3 = 501"), "stiffness_sigma_1e3"),
    "key-missing": (drop("pad.modulus_pa"), "modulus_pa"),
    "float-for-integer": (put("pad.thickness_um", "4000.0"), "thickness_um"),
    "text-for-integer": (put("pad.thickness_um", '"4000"'), "thickness_um"),
    "bool-for-integer": (put("grid.n_x", "true"), "n_x"),
    "nan": (put("pad.modulus_pa", "nan"), "modulus_pa"),
    "infinity": (put("pad.modulus_pa", "inf"), "modulus_pa"),
    "date": (put("pad.modulus_pa", "2026-11-21"), "modulus_pa"),
    "integer-for-text": (put("board.name", "5"), "name"),
    "empty-name": (put("board.name", '""'), "name"),
    "long-name": (put("board.name", '"' + "x" * 65 + '"'), "name"),
    "escaped-umlaut": (put("board.name", '"gr\\u00fcn"'), "name"),
    "escaped-zero": (put("board.product", '"sample\\u0000"'), "product"),
    "escaped-newline-in-list": (put("board.not_measured", '["torque\\nz"]'), "not_measured"),
    "list-of-integers": (put("board.not_measured", "[1, 2]"), "not_measured"),
    "list-too-long": (put("board.not_measured", str(["a"] * 9).replace("'", '"')), "not_measured"),
    "listed-text-too-long": (put("board.not_measured", '["' + "x" * 24 + '"]'), "not_measured"),
    "listed-text-empty": (put("board.not_measured", '[""]'), "not_measured"),
    "more-than-8000-bytes": (lambda t: t + "#" * (8_001 - len(t)), "8000 bytes"),
    "text-for-list": (put("board.not_measured", '"torque_z"'), "not_measured"),
    "negative-size": (put("pad.size_x_um", "-20000"), "size_x_um"),
    "zero-thickness": (put("pad.thickness_um", "0"), "thickness_um"),
    "poisson-half": (put("pad.poisson_1e4", "5000"), "poisson_1e4"),
    "one-layer": (put("grid.n_layers", "1"), "n_layers"),
    "one-node": (put("grid.n_y", "1"), "n_y"),
    "too-many-nodes": (put("grid.n_x", "256"), "n_x"),
    "image-too-wide": (put("camera.width_px", "4097"), "width_px"),
    "center-outside": (put("camera.center_x_mpx", "320000"), "center"),
    "sees-two-metres": (all_of(put("camera.focal_mpx", "10000"), put("camera.standoff_um", "500000")), "2 m"),
    "window-beyond-pad": (put("window.max_x_um", "20001"), "window"),
    "window-empty": (put("window.min_x_um", "20000"), "window"),
    "window-of-one-node": (all_of(put("window.min_x_um", "0"), put("window.max_x_um", "600")), "window"),
    "markers-missing": (drop_section("markers"), "markers"),
    "markers-beyond-pad": (put("markers.first_x_um", "15000"), "markers"),
    "markers-overlap": (put("markers.diameter_um", "5000"), "diameter_um"),
    "memory-too-small": (lambda t: t + "[memory]\ncalibration_kb = 63\n", "calibration_kb"),
    "memory-too-large": (lambda t: t + "[memory]\ncalibration_kb = 131073\n", "calibration_kb"),
    "reflex-without-a-limit": (append(REFLEX.replace("5000000", "0")), "no limit"),
    "reflex-negative": (append(REFLEX.replace("5000000", "-1")), "force_un"),
    "reflex-long-line": (append(REFLEX.replace("GRIP", "G" * 32)), "line"),
    "reflex-other-slip": (append(REFLEX.replace('"none"', '"sticks"')), "slip"),
    "reflex-without-invalid": (append(REFLEX.replace('when_invalid = "on"\n', "")), "when_invalid"),
    "temperature-without-path": (append('[temperature]\nplace = "gel"\n'), "path"),
    "temperature-relative-path": (append('[temperature]\nplace = "gel"\npath = "temp1_input"\n'), "begin with /"),
    "temperature-long-place": (append(f'[temperature]\nplace = "{"a" * 24}"\npath = "/t"\n'), "place"),
    "temperature-long-path": (append(f'[temperature]\nplace = "gel"\npath = "/{"a" * 128}"\n'), "path"),
    "exposure-without-time": (append(EXPOSURE), "time_us"),
    "exposure-longer-than-a-frame": (append(f"{EXPOSURE}time_us = 16667\n"), "longer than a frame"),
    "exposure-below-one": (append(f"{EXPOSURE}time_us = 9\n"), "time_us"),
    "exposure-gain": (append(f"{EXPOSURE.replace('2000', '999')}time_us = 900\n"), "gain_1e3"),
    "exposure-without-white": (append("[exposure]\ngain_1e3 = 2000\ntime_us = 900\n"), "white_kelvin instead"),
    "exposure-with-two-whites": (append(f"{EXPOSURE}time_us = 900\nwhite_kelvin = 5000\n"), "white_kelvin instead"),
    "exposure-without-blue": (append(f"{EXPOSURE.replace('blue_1e3 = 1700', '')}time_us = 900\n"), "blue_1e3"),
    "exposure-infrared": (append(f"{OF_USB.replace('5000', '999')}time_us = 900\n"), "white_kelvin"),
    "light-without-line": (append('[light]\nchip = "gpiochip0"\n'), "line"),
    "light-long-line": (append(f'[light]\nchip = "gpiochip0"\nline = "{"L" * 32}"\n'), "line"),
    "eeprom-of-nothing": (append(EEPROM), "needs board_address or gel_address"),
    "eeprom-twice": (append(f"{EEPROM}board_address = 80\ngel_address = 80\n"), "not the same"),
    "eeprom-reserved-address": (append(f"{EEPROM}gel_address = 7\n"), "gel_address"),
    "eeprom-relative-bus": (append(f"{EEPROM.replace('/dev/', '')}gel_address = 80\n"), "begin with /"),
    "light-alternates-too-slow": (
        append(f'{LIGHT}alternation = "lit_dark"\n{EXPOSURE}time_us = 8334\n'), "longer than half a frame"
    ),
    "light-alternates-with-automatics": (append(f'{LIGHT}alternation = "lit_dark"\n'), "needs [exposure]"),
    "light-alternation-unknown": (append(f'{LIGHT}alternation = "often"\n'), "alternation"),
    "led-driver-of-no-lamp": (append(f"{DRIVER}currents_ua = []\n"), "currents_ua"),
    "led-driver-of-17-lamps": (append(f"{DRIVER}currents_ua = {[1] * 17}\n"), "currents_ua"),
    "led-driver-of-58-ma": (append(f"{DRIVER}currents_ua = [57376]\n"), "currents_ua"),
    "led-driver-relative-bus": (append(f"{DRIVER.replace('/dev/', '')}currents_ua = [1]\n"), "begin with /"),
    "led-driver-without-a-thermometer": (
        append(f"{DRIVER}currents_ua = [1]\nmax_milli_celsius = 60000\n"), "needs [temperature]"
    ),
    "stereo-of-a-whole-frame": (append("[stereo]\ntolerance_us = 8334\n"), "longer than half a frame"),
    "stereo-of-an-odd-width": (
        all_of(put("camera.width_px", "321"), put("depth.step_px", "1"), append("[stereo]\ntolerance_us = 9\n")),
        "even camera.width_px",
    ),
    "stereo-that-alternates": (
        append(f'{LIGHT}alternation = "lit_dark"\n[stereo]\ntolerance_us = 9\n'), "cannot be had together"
    ),
    "threads-before-interrupts": (append("[threads]\nframe_priority = 50\n"), "frame_priority"),
    "threads-of-priority-zero": (append("[threads]\nlink_priority = 0\n"), "link_priority"),
    "threads-of-no-cpu": (append("[threads]\nframe_cpus = []\n"), "frame_cpus"),
    "threads-of-cpu-64": (append("[threads]\nframe_cpus = [64]\n"), "frame_cpus"),
    "threads-of-a-text": (append('[threads]\nframe_cpus = "0-3"\n'), "frame_cpus"),
    "threads-idle-before-others": (append("[threads]\ninference_priority = 9\n"), "inference_priority"),
    "learned-without-network": (append("[learned]\n"), "network"),
    "learned-in-a-folder": (append('[learned]\nnetwork = "../net.onnx"\n'), "without /"),
    "memory-empty": (lambda t: t + "[memory]\n", "calibration_kb"),
    "texture-and-photometric": (put("markers.polarity", '"texture"'), "photometric"),
    "texture-in-a-small-image": (
        all_of(
            put("markers.polarity", '"texture"'),
            put("pipeline.stages", '["difference", "markers", "displacement"]'),
            put("camera.height_px", "62"),
            put("camera.center_y_mpx", "30000"),
        ),
        "64",
    ),
    "layout-unknown": (add("markers", 'layout = "hexagonal"'), "layout"),
    "places-on-a-lattice": (add("markers", "places_um = [[1, 2]]"), "places_um"),
    "places-too-few": (add("markers", 'layout = "scattered"\nplaces_um = [[1, 2]]'), "places_um"),
    "places-twice": (
        all_of(
            add("markers", 'layout = "scattered"\nplaces_um = [[0, 0], [4000, 500], [0, 0], [5, 6]]'),
            put("markers.n_x", "2"), put("markers.n_y", "2"),
        ),
        "twice",
    ),
    "places-beyond-the-pad": (
        all_of(
            add("markers", 'layout = "scattered"\nplaces_um = [[0, 0], [4000, 500], [20001, 0], [5, 6]]'),
            put("markers.n_x", "2"), put("markers.n_y", "2"),
        ),
        "places_um",
    ),
    "places-of-three": (add("markers", 'layout = "scattered"\nplaces_um = [[1, 2, 3]]'), "places_um"),
    "places-of-floats": (add("markers", 'layout = "scattered"\nplaces_um = [[1.0, 2.0]]'), "places_um"),
    "places-of-bools": (add("markers", 'layout = "scattered"\nplaces_um = [[true, 2]]'), "places_um"),
    "places-empty": (add("markers", 'layout = "scattered"\nplaces_um = []'), "places_um"),
    "views-with-nodes": (
        all_of(
            add("markers", 'layout = "views"'), put("markers.n_x", "1024"), put("markers.n_y", "2"),
            put("pipeline.stages", '["difference", "markers", "displacement"]'),
        ),
        "displacement",
    ),
    "views-that-do-not-fill-the-frame": (
        all_of(
            add("markers", 'layout = "views"'), put("markers.n_x", "292"), put("markers.n_y", "3"),
            put("pipeline.stages", '["difference", "markers"]'),
        ),
        "width_px",
    ),
    "fingertip-without-eyes": (put("pipeline.stages", '["difference", "markers", "fingertip"]'), "views"),
    "fingertip-of-three-eyes": (
        all_of(
            add("markers", 'layout = "views"'), put("markers.n_x", "292"), put("markers.n_y", "4"),
            put("pipeline.stages", '["difference", "markers", "fingertip"]'),
        ),
        "n_y 2",
    ),
    "views-of-too-many": (
        all_of(
            add("markers", 'layout = "views"'), put("markers.n_x", "1025"), put("markers.n_y", "2"),
            put("pipeline.stages", '["difference", "markers"]'),
        ),
        "n_x",
    ),
    "scattered-too-many": (all_of(add("markers", 'layout = "scattered"'), put("markers.n_x", "65")), "n_x"),
    "dark-markers-of-high-contrast": (put("markers.threshold_1e3", "901"), "threshold_1e3"),
    "texture-and-scattered": (
        all_of(
            add("markers", 'layout = "scattered"'),
            put("markers.polarity", '"texture"'),
            put("pipeline.stages", '["difference", "markers", "displacement"]'),
        ),
        "layout",
    ),
    "polarity-unknown": (put("markers.polarity", '"grey"'), "polarity"),
    "gauge-unknown": (put("depth.gauge", '"guess"'), "gauge"),
    "gauge-of-scattered-markers": (
        all_of(put("depth.gauge", '"volume"'), add("markers", 'layout = "scattered"')), "layout"
    ),
    "gauge-without-displacement": (
        all_of(put("depth.gauge", '"both"'), put("pipeline.stages", '["difference", "photometric", "poisson"]')),
        "displacement",
    ),
    "gauge-of-depth-from-markers": (
        all_of(
            put("depth.gauge", '"spacing"'), add("depth", 'source = "markers"'), put("pipeline.stages", WITHOUT_LIGHT)
        ),
        "poisson",
    ),
    "source-unknown": (add("depth", 'source = "sonar"'), "source"),
    "source-twice-measured": (add("depth", 'source = "markers"'), "photometric"),
    "source-without-displacement": (
        all_of(add("depth", 'source = "markers"'), put("pipeline.stages", '["difference", "markers"]')), "displacement"
    ),
    "source-of-scattered-markers": (
        all_of(
            add("depth", 'source = "markers"'), put("pipeline.stages", WITHOUT_LIGHT),
            add("markers", 'layout = "scattered"'),
        ),
        "layout",
    ),
    "step-float": (put("depth.step_px", "2.0"), "step_px"),
    "step-bool": (put("depth.step_px", "true"), "step_px"),
    "step-3": (put("depth.step_px", "3"), "step_px"),
    "step-does-not-divide": (all_of(put("camera.width_px", "322"), put("depth.step_px", "4")), "step_px"),
    "depth-grid-too-large": (
        all_of(put("camera.width_px", "1280"), put("depth.step_px", "1")), "640"
    ),
    "force-step-zero": (put("field.force_lsb_un", "0"), "force_lsb_un"),
    "no-rest-frames": (put("pipeline.n_rest_frames", "0"), "n_rest_frames"),
    "no-stages": (put("pipeline.stages", "[]"), "stages"),
    "unknown-stage": (put("pipeline.stages", '["difference", "magic"]'), "stages"),
    "stages-out-of-order": (put("pipeline.stages", '["poisson", "difference"]'), "stages"),
    "skin-stage-without-section": (put("pipeline.stages", '["skin"]'), "skin"),
    "skin-without-weights": (append(SKIN.replace("weight_g = 1", "weight_g = 0")), "weights"),
    "skin-weights-too-large": (
        append(SKIN.replace("weight_g = 1", "weight_g = 8").replace("_b = 0", "_b = 1")), "weights"
    ),
    "skin-tube-without-radius": (append(SKIN.replace("40000", "0")), "radius_um"),
    "skin-plane-with-radius": (append(SKIN.replace("tube", "plane")), "radius_um"),
    "skin-unknown-mode": (append(SKIN.replace("auto", "some")), "mode"),
    "skin-averages-too-long": (append(SKIN.replace("averaged_frames = 3", "averaged_frames = 11")), "averaged_frames"),
    "targets-stage-without-section": (put("pipeline.stages", '["targets"]'), "targets"),
    "targets-without-places": (append(TARGETS.replace("[[5000, 5000], [9000, 8000]]", "[]")), "places_um"),
    "targets-place-of-three": (append(TARGETS.replace("[5000, 5000]", "[5000, 5000, 0]")), "places_um"),
    "targets-beyond-the-pad": (append(TARGETS.replace("9000", "400000")), "places_um"),
    "targets-behind-the-camera": (append(TARGETS.replace("below_um = 2000", "below_um = 400000")), "below_um"),
    "targets-too-small-to-measure": (append(TARGETS.replace("3000", "100")), "diameter_um"),
    "feature-wrench-of-nothing": (put("pipeline.stages", '["difference", "feature_wrench"]'), "feature_wrench"),
    "two-wrenches": (put("pipeline.stages", '["markers", "wrench", "feature_wrench"]'), "feature_wrench"),
    "helmholtz-of-nothing": (
        all_of(put("markers.polarity", '"texture"'), put("pipeline.stages", '["markers", "helmholtz"]')), "helmholtz"
    ),
    "helmholtz-of-an-oblong-lattice": (
        all_of(
            put("markers.polarity", '"texture"'),
            put("markers.n_x", "2"),
            put("markers.pitch_x_um", "4001"),
            put("pipeline.stages", WITH_CONTACT_MODEL[:-1] + ', "helmholtz"]'),
        ),
        "four times",
    ),
    "contact-depth-of-nothing": (
        all_of(put("markers.polarity", '"texture"'), put("pipeline.stages", '["markers", "contact_depth"]')),
        "contact_model",
    ),
    "contact-model-of-dots": (put("pipeline.stages", WITH_CONTACT_MODEL), "contact_model"),
    "contact-model-and-contacts": (
        all_of(
            put("markers.polarity", '"texture"'),
            put("pipeline.stages", '["markers", "feature_wrench", "contacts", "contact_model"]'),
        ),
        "contact_model",
    ),
    "stage-twice": (put("pipeline.stages", '["difference", "difference"]'), "stages"),
}  # fmt: skip


def main() -> None:
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else HERE
    base = (HERE / "base.toml").read_text()
    lines = ["# Made by make_corpus.py. file | a word of the error; good files have none\n"]
    for kind, names in (("good", GOOD), ("bad", BAD)):
        (folder / kind).mkdir(parents=True, exist_ok=True)
        for name in names:
            change, word = (GOOD[name], "") if kind == "good" else BAD[name]
            text = change(base)
            data = text[5:].encode("utf-16") if text.startswith("UTF16") else text.encode("utf-8", "surrogateescape")
            (folder / kind / f"{name}.toml").write_bytes(data)
            lines.append(f"{kind}/{name}.toml | {word}\n")
    (folder / "index.txt").write_text("".join(lines))


if __name__ == "__main__":
    main()
