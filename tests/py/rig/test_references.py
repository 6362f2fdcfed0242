"""References: each reads its real protocol, and says in one sentence what is wrong."""

from __future__ import annotations

import http.server
import threading

import numpy as np
import pytest
from fakes import FakeFx29, RdtServer, printing_board
from hang import HANG_S, until

from ruffini.errors import InputError, NoDeviceError
from ruffini.rig.csv_log import gauges_of, read_csv_log
from ruffini.rig.i2c_cell import I2cCell, parse_part
from ruffini.rig.network_cell import NetworkCell, Settings, fetch_settings, parse_settings
from ruffini.rig.placed_weight import PlacedWeight
from ruffini.rig.reference import Reference
from ruffini.rig.settings import load_rig
from ruffini.rig.text_cell import TextCell, parse_line

PAGE = b"""<?xml version="1.0"?><netft><cfgcpf>1000000</cfgcpf><cfgcpt>500000</cfgcpt>
<scfgfu>%s</scfgfu><scfgtu>%s</scfgtu><comrdtrate>500</comrdtrate></netft>"""
SCALE = np.array([50.0, 50, 100, 1, 1, 1])
SIGMA = SCALE / 400


def read_on(reference: Reference, timeout_s: float = 0.2) -> None:
    """Read until it fails, fifty times at most."""
    for _ in range(50):
        reference.read(timeout_s)


# ---- FX29 over I2C


def fx29(part: str = "FX29K1-040B-0010-N") -> tuple[I2cCell, FakeFx29]:
    chip = FakeFx29(parse_part(part).address, parse_part(part).full_scale_n)
    return I2cCell(part, chip), chip


def test_i2c_cell_reads_newtons_and_presses_along_minus_z():
    cell, chip = fx29()
    chip.force_n = 2.5
    reading = cell.read(0.5)[0]
    assert reading.wrench[2] == pytest.approx(-2.5, abs=10 / 14000)
    assert np.isnan(reading.wrench[[0, 1, 3, 4, 5]]).all()
    assert cell.facts.axes == ("fz",)


def test_i2c_part_number_in_pounds_is_converted():
    cell, chip = fx29("FX29K0-040B-0010-L")
    assert chip.address == 0x28
    assert cell.facts.full_scale[2] == pytest.approx(44.482, abs=1e-3)
    chip.force_n = 22.241
    assert cell.read(0.5)[0].wrench[2] == pytest.approx(-22.241, abs=0.01)


def test_i2c_stale_measurement_is_asked_again_and_not_taken_twice():
    cell, chip = fx29()
    chip.CONVERSION_S = 0.5  # every read comes too early
    with pytest.raises(NoDeviceError, match="nothing new"):
        cell.read(0.05)
    chip.CONVERSION_S = 0.004
    assert cell.read(0.05)[0].wrench[2] == pytest.approx(0)


def test_i2c_saturation_is_marked():
    cell, chip = fx29()
    chip.force_n = 9.9
    assert not cell.read(0.5)[0].is_saturated
    chip.force_n = 11.0
    assert cell.read(0.5)[0].is_saturated


@pytest.mark.parametrize(
    ("fault", "sentence"),
    [("is_plugged", "does not answer"), ("has_fault", "reports a fault"), ("is_broken", "far below its zero")],
)
def test_i2c_failures_are_named(fault, sentence):
    cell, chip = fx29()
    setattr(chip, fault, fault != "is_plugged")
    with pytest.raises(NoDeviceError, match=sentence):
        cell.read(0.1)


@pytest.mark.parametrize("number", ["FX293X-100A-0025-L", "", "FX29K9-040B-0010-N", "HX711"])
def test_i2c_part_without_i2c_is_refused(number):
    with pytest.raises(InputError, match="no part number"):
        parse_part(number)


# ---- text lines over serial


@pytest.mark.parametrize(
    ("text", "value", "unit"),
    [("12.5", 12.5, None), ("weight: -3 g", -3, "g"), ("17,2.0e1 kg", 20, "kg"), ("load=.5lb", 0.5, "lb")],
)
def test_line_is_parsed(text, value, unit):
    assert parse_line(text) == (value, unit, False)


@pytest.mark.parametrize("text", ["HX711 ready"[:2], "", "taring ..."])
def test_line_without_number(text):
    assert parse_line(text) is None


def test_text_cell_reads_grams_after_the_boards_greeting():
    lines = iter([b"\xff\xfe", b"ts\r\nready\r\n", b"10"])
    with printing_board(lambda: next(lines, b"100.0 g\r\n")) as (port, _):
        cell = TextCell(port, "g", full_scale_n=10, sigma_n=0.01)
        until(lambda: cell.read(1)[-1].wrench[2] == pytest.approx(-0.980665), "100 g")
        cell.close()


def test_text_cell_in_pounds_is_named():
    with printing_board(lambda: "0.22 lb") as (port, _), pytest.raises(InputError, match=r"counts in lb.*unit = 'lb'"):
        TextCell(port, "g", 10, 0.01).read(1)


def test_text_cell_saturation_by_word_and_by_range():
    text = ["OVF"]
    with printing_board(lambda: text[0]) as (port, _):
        cell = TextCell(port, "N", 10, 0.01)
        assert cell.read(1)[0].is_saturated
        text[0] = "10.5"
        until(lambda: cell.read(1)[-1].is_saturated, "saturation")
        cell.close()


def test_text_cell_that_stops_making_sense_or_is_unplugged():
    text = ["1.0"]
    with printing_board(lambda: text[0]) as (port, unplug):
        cell = TextCell(port, "N", 10, 0.01)
        cell.read(1)
        text[0] = "sensor error"
        with pytest.raises(InputError, match="'sensor error' has no number"):
            read_on(cell, HANG_S)
        unplug()
        with pytest.raises(NoDeviceError, match=r"unplugged|no number"):
            cell.read(0.1)
        cell.close()


def test_text_cell_on_no_port(tmp_path):
    with pytest.raises(NoDeviceError, match="cannot be opened"):
        TextCell(str(tmp_path / "none"), "g", 10, 0.01)


# ---- six axes over UDP


def settings() -> Settings:
    return parse_settings(PAGE % (b"N", b"Nm"), "page")


def test_network_cell_reads_six_axes():
    with RdtServer() as box:
        box.counts = [1_000_000, 0, -2_500_000, 5000, 0, -500_000]
        cell = NetworkCell("127.0.0.1", SCALE, SIGMA, settings=settings(), port=box.port)
        wrench = cell.read(1)[-1].wrench
        assert wrench == pytest.approx([1, 0, -2.5, 0.01, 0, -1], abs=1e-12)
        assert cell.facts.axes == ("fx", "fy", "fz", "tx", "ty", "tz")
        cell.close()
        until(lambda: not box.is_streaming, "the end of the stream")


def test_network_cell_counts_lost_and_drops_repeated_records():
    with RdtServer() as box:
        box.skip, box.repeat = {5, 6}, {8, 9}
        cell = NetworkCell("127.0.0.1", SCALE, SIGMA, settings=settings(), port=box.port)
        n = 0
        while n < 20:
            n += len(cell.read(1))
        assert cell.n_lost == 2
        cell.close()


def test_network_cell_saturates_fails_and_falls_silent():
    with RdtServer() as box:
        cell = NetworkCell("127.0.0.1", SCALE, SIGMA, settings=settings(), port=box.port)
        assert not cell.read(1)[-1].is_saturated
        box.status = 0x80020000
        until(lambda: cell.read(1)[-1].is_saturated, "saturation")
        box.status, box.counts = 0, [0, 0, 100_000_000, 0, 0, 0]
        assert [r for _ in range(20) for r in cell.read(1)][-1].is_saturated  # at its range
        box.status = 0x80800000
        with pytest.raises(NoDeviceError, match="status 0x80800000"):
            read_on(cell, HANG_S)
        box.is_streaming = False
        with pytest.raises(NoDeviceError, match="nothing"):
            read_on(cell)
        cell.close()


def test_network_settings_come_from_its_page_in_its_units():
    page = [PAGE % (b"lbf", b"lbf-in")]

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200 if self.path == "/netftapi2.xml" else 404)
            self.end_headers()
            self.wfile.write(page[0])

        def log_message(self, *_):
            pass

    with http.server.HTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        got = fetch_settings("127.0.0.1", server.server_port)
        page[0] = PAGE % (b"stone", b"Nm")
        with pytest.raises(InputError, match="'stone' is no unit of force"):
            fetch_settings("127.0.0.1", server.server_port)
        page[0] = b"<html>"
        with pytest.raises(InputError, match="no configuration"):
            fetch_settings("127.0.0.1", server.server_port)
        server.shutdown()
    assert got.per_count[2] == pytest.approx(4.4482216e-6)
    assert got.per_count[5] == pytest.approx(0.1129848 / 500000, rel=1e-6)
    assert got.rate_hz == 500
    with pytest.raises(NoDeviceError, match="cannot be read"):
        fetch_settings("127.0.0.1", server.server_port)


# ---- a weight, a log


def test_placed_weight():
    weight = PlacedWeight(0.05)
    assert weight.read(0.01)[0].wrench[2] == 0
    weight.place(102)
    assert weight.read(0.01)[0].wrench[2] == pytest.approx(-1.00027830)
    assert weight.facts.sigma[2] == pytest.approx(0.05e-3 * 9.80665)
    with pytest.raises(InputError, match="no weight for a pad"):
        weight.place(-1)


def test_csv_log_with_units(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("time_ms,Fz [lbf],fx_N,Ty (Nmm),note\n0,-1,0.5,20,a\n10,-2,0.25,30,b\n")
    log = read_csv_log(path)
    assert log.time_s.tolist() == [0, 0.01]
    assert log.wrench[:, 2] == pytest.approx([-4.4482216, -8.8964432])
    assert log.wrench[:, 0].tolist() == [0.5, 0.25]
    assert log.wrench[:, 4] == pytest.approx([0.02, 0.03])
    assert np.isnan(log.wrench[:, [1, 3, 5]]).all()


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("fz_N\n1\n2\n", "no column of time"),
        ("time_s,fx_N\n0,1\n1,1\n", "no column of the normal force"),
        ("time_s,fz\n0,1\n1,1\n", "has no unit"),
        ("time_s,fz_stone\n0,1\n1,1\n", "no unit of force"),
        ("time_s,fz_N,Fz [N]\n0,1,1\n1,1,1\n", "two columns"),
        ("time_s,fz_N\n0,1\n1,\n", "line 3: a cell is missing"),
        ("time_s,fz_N\n0,1\n1,nan\n", "line 3: a cell is missing or no number"),
        ("time_s,fz_N\n0,1\n1,1\n1,1\n", "line 4: time stands still"),
        ("time_s,fz_N\n0,1\n", "at least two"),
        ("", "is empty: its first row must name the columns"),
    ],
)
def test_csv_log_faults_are_named(tmp_path, text, sentence):
    path = tmp_path / "log.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=sentence):
        read_csv_log(path)


GAUGES = ["ai0", "ai1", "ai2", "ai3", "ai4", "ai5"]
MATRIX = [
    [0.0, 2.0, 0.0, 0.0, 0.0, 0.0],
    [0.0, 0.0, 3.0, 0.0, 0.0, 0.0],
    [5.0, 0.0, 0.0, -1.0, 0.0, 0.0],
    [0.0, 0.0, 0.0, 0.5, 0.0, 0.0],
    [0.0, 0.0, 0.0, 0.0, 0.25, 0.0],
    [0.0, 0.0, 0.0, 0.0, 0.0, 0.125],
]
VOLTAGES = "Time (ms),ai5,ai4,ai3,ai2,ai1,ai0,fx\n0,8,4,2,1,1,-1,none\n10,0,0,0,0,1,-2,none\n"


def with_matrix(row: int, values: list[object]) -> list[object]:
    return [values if i == row else one for i, one in enumerate(MATRIX)]


def test_csv_log_of_voltages_becomes_wrenches(tmp_path):
    path = tmp_path / "daq.csv"
    path.write_text(VOLTAGES)
    log = read_csv_log(path, gauges_of(GAUGES, MATRIX))
    assert log.time_s.tolist() == [0, 0.01]
    assert log.wrench.tolist() == [[2, 3, -7, 1, 1, 1], [2, 0, -10, 0, 0, 0]]


@pytest.mark.parametrize(
    ("columns", "matrix", "sentence"),
    [
        (None, MATRIX, "columns must name the 6 columns .* not None"),
        ("ai0:5", MATRIX, "columns must name the 6 columns .* not 'ai0:5'"),
        (GAUGES[:5], MATRIX, "columns must name the 6 columns"),
        ([*GAUGES[:5], "ai0"], MATRIX, "columns must name the 6 columns"),
        ([*GAUGES[:5], 5], MATRIX, "columns must name the 6 columns"),
        (GAUGES, None, "matrix must be six rows"),
        (GAUGES, MATRIX[:5], "matrix must be six rows"),
        (GAUGES, with_matrix(2, [1.0] * 7), "matrix must be six rows"),
        (GAUGES, with_matrix(2, [1.0, 2.0, 3.0, 4.0, 5.0, "6"]), "matrix must be six rows"),
        (GAUGES, with_matrix(3, [0, 0, 0, float("nan"), 0, 0]), "number in row tx that is not finite"),
        (GAUGES, with_matrix(5, [0, 0, 0, 0, 0, float("inf")]), "number in row tz that is not finite"),
        (GAUGES, with_matrix(1, [0.0, 3.0, 0.0, 0.0, 0.0, 0.0]), "matrix is singular"),
        (GAUGES, with_matrix(4, [0.0] * 6), "matrix is singular"),
    ],
)
def test_gauges_that_are_wrong_are_named(columns, matrix, sentence):
    with pytest.raises(InputError, match=sentence):
        gauges_of(columns, matrix)


def test_a_matrix_of_small_moments_is_not_singular():
    matrix = [*MATRIX[:3], *([1e-7 * v for v in row] for row in MATRIX[3:])]
    assert gauges_of(GAUGES, matrix).matrix.tolist() == matrix


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("ai3", "ai9", "has no column 'ai3', only Time .*: correct columns"),
        (",fx", ",ai3", "has 2 columns 'ai3', only"),
        ("Time", "When", "no column of time"),
        ("0,8,4", "0,nan,4", "line 2: a cell is missing or no number"),
        ("10,0", "0,0", "line 3: time stands still"),
    ],
)
def test_csv_log_of_voltages_faults_are_named(tmp_path, old, new, sentence):
    path = tmp_path / "daq.csv"
    path.write_text(VOLTAGES.replace(old, new))
    with pytest.raises(InputError, match=sentence):
        read_csv_log(path, gauges_of(GAUGES, MATRIX))


BENCH = 'schema = 1\n[reference]\nkind = "csv"\npath = "daq.csv"\n{}\n[limits]\nmax_force_n = 5.0\n'


def test_a_bench_with_gauges(tmp_path):
    path = tmp_path / "bench.toml"
    path.write_text(BENCH.format(f"columns = {GAUGES}\nmatrix = {MATRIX}"))
    gauges = load_rig(path).reference.gauges()
    assert gauges.columns == GAUGES
    assert gauges.matrix.tolist() == MATRIX
    path.write_text(BENCH.format(""))
    assert load_rig(path).reference.gauges() is None


@pytest.mark.parametrize(
    ("keys", "sentence"),
    [
        (f"columns = {GAUGES}", r"bench\.toml: reference\.csv: matrix must be six rows"),
        (f"matrix = {MATRIX}", r"bench\.toml: reference\.csv: columns must name the 6 columns"),
        (f"columns = {GAUGES}\nmatrix = {[MATRIX[0], *MATRIX[:5]]}", r"reference\.csv: matrix is singular"),
    ],
)
def test_a_bench_with_wrong_gauges_is_named(tmp_path, keys, sentence):
    path = tmp_path / "bench.toml"
    path.write_text(BENCH.format(keys))
    with pytest.raises(InputError, match=sentence):
        load_rig(path)
