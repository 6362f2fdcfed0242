"""A box that sends packets over serial or TCP: its bytes, what it answers, and what is wrong in one sentence."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from hang import HANG_S, guard, until

from ruffini.errors import InputError, NoDeviceError, RefusedError, RuffiniError
from ruffini.rig import packet_cell
from ruffini.rig.byte_line import SerialLine, TcpLine
from ruffini.rig.emulated_references import EmulatedPacketCell
from ruffini.rig.packet_cell import PacketCell, Packets
from ruffini.rig.reference import Reading, Reference
from ruffini.rig.settings import load_rig

SCALE = np.array([50.0, 50, 100, 1, 1, 1])
SIGMA = SCALE / 400
WRENCH = np.array([1.0, -2, 0.5, 0, 0, 0.25])
BY_HAND = bytes.fromhex("aa55 001b 0007 0000803f 000000c0 0000003f 00000000 00000000 0000803e 7c")  # WRENCH, number 7
COMMANDS = ["AT+GSD=STOP", "AT+SMPF=100", "AT+SGDM=(A01,A02,A03,A04,A05,A06);E;1;(WMA:1)", "AT+GSD"]


def packet(number: int, fx: float = 1.0) -> bytes:
    data = struct.pack("<ffffff", fx, 0, 0, 0, 0, 0)
    return b"\xaa\x55\x00\x1b" + number.to_bytes(2, "big") + data + bytes([sum(data) % 256])


@pytest.fixture(params=["serial", "tcp"])
def box(request) -> Iterator[EmulatedPacketCell]:
    with guard(request.node.name), EmulatedPacketCell(1, is_tcp=request.param == "tcp", noise=0) as emulated:
        emulated.mount = emulated.mount._replace(hanging=(0.0,) * 6)
        yield emulated


@pytest.fixture
def serial_box(request) -> Iterator[EmulatedPacketCell]:
    with guard(request.node.name), EmulatedPacketCell(1, noise=0) as emulated:
        yield emulated


@pytest.fixture
def is_impatient(monkeypatch) -> None:
    """Silence is found out at once; only for tests that await no answer."""
    monkeypatch.setattr(packet_cell, "ANSWER_S", 0.02)


def connect(box: EmulatedPacketCell, **options: int) -> PacketCell:
    line = SerialLine(box.port, 115200) if box.port else TcpLine("127.0.0.1", box.tcp_port)
    return PacketCell(line, SCALE, SIGMA, **options)


def read(cell: Reference, n: int) -> list[Reading]:
    """The next n readings; what comes besides fails."""
    readings: list[Reading] = []
    while len(readings) < n:
        readings += cell.read(HANG_S)
    assert len(readings) == n
    return readings


@contextlib.contextmanager
def again_and_again(do: Callable[[], object]) -> Iterator[None]:
    """Done every two milliseconds by another thread."""
    stop = threading.Event()

    def run() -> None:
        while not stop.wait(0.002):
            do()

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


# ---- bytes


def test_a_packet_made_by_hand_is_a_wrench() -> None:
    packets = Packets()
    (wrench,) = packets.feed(BY_HAND)
    assert wrench.tolist() == WRENCH.tolist()
    assert packets.feed(BY_HAND[:20]) == []
    assert [w.tolist() for w in packets.feed(BY_HAND[20:])] == [WRENCH.tolist()]


def test_any_pieces_give_the_same_packets_between_damage() -> None:
    header_inside = struct.unpack("<f", b"\xaa\x55\x00\x1b")[0]
    damaged = bytearray(packet(4, 4.0))
    damaged[9] ^= 0x10
    whole = (b"ACK+GSD=$OK\r\n" + packet(1, 1.0) + b"\xaa\x55\xaa" + packet(2, header_inside) + packet(3, 3.0)[:17]
             + bytes(damaged) + packet(5, 5.0) + packet(6, 6.0) + b"\xaa")  # fmt: skip
    for size in (1, 2, 3, 7, 30, 31, 32, len(whole)):
        packets = Packets()
        found = [w[0] for i in range(0, len(whole), size) for w in packets.feed(whole[i : i + size])]
        assert found == [1.0, header_inside, 5.0, 6.0], size
        assert packets.n_lost == 2
        assert packets.n_strange_bytes == 0
        packets.feed(b"\x55" + packet(7)[2:] + packet(8))
        assert packets.n_lost == 2, "the header was in two pieces"


def test_a_damaged_header_before_a_whole_packet_hides_nothing() -> None:
    for lie in (b"\xaa\x55\xff\xff", b"\xaa\x55\x00\x1b", b"\xaa\x55\x00\x00", b"\xaa\xaa\x55\x00\x1b\x00"):
        packets = Packets()
        assert len(packets.feed(lie + packet(1) + packet(2) + packet(3))) == 3, lie


def test_numbers_count_what_is_lost_and_begin_again_after_65535() -> None:
    packets = Packets()
    packets.feed(b"".join(packet(n) for n in (65533, 65534, 1, 2, 3)))
    assert packets.n_lost == 2
    packets.feed(b"".join(packet(n) for n in (6, 8, 9)))
    assert packets.n_lost == 5


def test_a_damaged_number_or_a_restarted_box_is_no_loss() -> None:
    """The checksum covers the data only."""
    packets = Packets()
    packets.feed(b"".join(packet(n) for n in (10, 11, 0x400C, 13, 14, 0, 1, 2)))
    assert packets.n_lost == 0


def test_values_that_are_no_numbers_are_dropped_and_counted() -> None:
    packets = Packets()
    found = packets.feed(b"".join(packet(i, v) for i, v in enumerate([1.0, np.nan, np.inf, -np.inf, 2.0])))
    assert [w[0] for w in found] == [1.0, 2.0]
    assert packets.n_not_finite == 3
    assert packets.n_lost == 0


def test_no_bytes_break_it() -> None:
    rng = np.random.default_rng(1)
    packets = Packets()
    for _ in range(500):
        noise = rng.choice(np.frombuffer(b"\xaa\x55\x00\x1b\x01", np.uint8), rng.integers(0, 80)).tobytes()
        assert all(np.isfinite(w).all() for w in packets.feed(noise))
    assert len(packets.feed(bytes(31) + packet(1) + packet(2))) >= 2


# ---- the box


def test_it_is_asked_for_six_channels_and_streams(box) -> None:
    cell = connect(box)
    assert box.asked == COMMANDS
    box.measure(0, WRENCH)
    (reading,) = read(cell, 1)
    assert reading.wrench.tolist() == WRENCH.tolist()
    assert not reading.is_saturated
    assert cell.facts.axes == ("fx", "fy", "fz", "tx", "ty", "tz")
    assert cell.facts.rate_hz == 100
    cell.close()
    until(lambda: box.asked[-1] == "AT+GSD=STOP", "the end of the stream")
    until(lambda: not box.is_streaming, "the end of the stream")


def test_damage_on_the_line_costs_the_packets_that_it_hit(box) -> None:
    cell = connect(box, rate_hz=250)
    assert "AT+SMPF=250" in box.asked
    box.send(packet(65535, 1.0) + packet(0, 2.0)[:13] + b"\xaa\x55\xff\xff" + packet(1, 3.0) + packet(2, 4.0))
    assert [r.wrench[0] for r in read(cell, 3)] == [1.0, 3.0, 4.0]
    assert cell.n_lost == 1
    box.send(packet(3, np.nan) + packet(4, 5.0))
    assert [r.wrench[0] for r in read(cell, 1)] == [5.0]
    assert cell.n_lost == 2, "one of them has no reading"
    cell.close()


def test_readings_received_together_have_times_that_rise(serial_box) -> None:
    cell = connect(serial_box)
    readings: list[Reading] = []
    for n in (5, 3, 1, 4):
        serial_box.send(b"".join(packet(len(readings) + i) for i in range(n)))
        readings += read(cell, n)
    steps = np.diff([r.host_s for r in readings])
    assert steps.min() > 0
    assert steps[:4] == pytest.approx(0.01)
    cell.close()


def test_it_is_saturated_at_its_range_on_any_axis(box) -> None:
    cell = connect(box)
    for axis in range(6):
        for part, is_saturated in ((0.99, False), (-1.0, True), (1.5, True)):
            box.measure(0, part * SCALE * (np.arange(6) == axis))
            assert read(cell, 1)[0].is_saturated is is_saturated
    cell.close()


def test_an_older_box_is_asked_for_its_rate_by_the_older_name(box) -> None:
    box.refused.add("SMPF")
    connect(box).close()
    until(lambda: len(box.asked) == 6, "the last command")
    assert box.asked[1:4] == ["AT+SMPF=100", "AT+SMPR=100", COMMANDS[2]]


@pytest.mark.parametrize(
    ("refused", "sentence"),
    [
        ({"SMPF", "SMPR"}, r"answers 'ACK\+SMPF=100\$ERROR' to AT\+SMPF=100: give a rate_hz"),
        ({"SGDM"}, r"answers 'ACK\+SGDM=.*\$ERROR' to AT\+SGDM=.*: it must send six channels"),
        ({"GSD"}, r"answers 'ACK\+GSD=\$ERROR' to AT\+GSD: see its manual"),
    ],
)
def test_a_command_that_is_refused_is_named(box, refused, sentence) -> None:
    box.refused |= refused
    with pytest.raises(RefusedError, match=sentence):
        connect(box)
    assert not box.is_streaming


def test_a_stream_that_a_killed_program_left_is_stopped_first(serial_box) -> None:
    serial_box.is_streaming = True
    with again_and_again(lambda: serial_box.measure(0, WRENCH)):
        cell = connect(serial_box)
        assert cell.read(HANG_S)
    assert serial_box.asked == COMMANDS
    cell.close()


@pytest.mark.parametrize("ignored", [set(), {"GSD"}])
def test_packets_are_an_answer_to_the_start(box, ignored) -> None:
    """And none of them is lost."""
    box.ignored |= ignored
    box.first = b"".join(packet(n, n) for n in (1, 2, 3, 4))
    cell = connect(box)
    assert [r.wrench[0] for r in read(cell, 4)] == [1, 2, 3, 4]
    assert box.asked == COMMANDS
    cell.close()


def test_a_box_that_does_not_answer_is_named(box, is_impatient) -> None:
    box.ignored |= {"SMPF", "SMPR"}
    with pytest.raises(NoDeviceError, match=r"(on /dev/pts/\d+|at 127.0.0.1:\d+) does not answer AT\+SMPF=100: is it "):
        connect(box)


def test_a_box_that_falls_silent_is_named(box) -> None:
    cell = connect(box)
    with pytest.raises(NoDeviceError, match=r"sends nothing for 0\.02 s: is it plugged in"):
        cell.read(0.02)
    box.send(packet(1)[:30])
    with pytest.raises(NoDeviceError, match="sends nothing"):
        cell.read(0.02)
    cell.close()


def test_a_box_that_sends_no_numbers_is_named(box) -> None:
    cell = connect(box)
    box.measure(0, np.full(6, np.nan))
    with pytest.raises(NoDeviceError, match="only values that are NaN or infinite: is the sensor plugged into it"):
        cell.read(0.1)
    cell.close()


@pytest.mark.parametrize(
    ("sent", "sentence"),
    [
        (b"\xaa\x55\x00\x23" + bytes(35), r"packets of length 35 instead of 27: check in its manual"),
        (b"\xaa\x55\xff\xff" + bytes(35), r"packets of length 65535 instead of 27"),
        (b"\x00\x80\xf8" * 20, r"sent \d{4} bytes without a whole packet: check the cable and the baud rate"),
        (BY_HAND[:-1] + b"\x7d", r"sent \d{4} bytes without a whole packet"),
    ],
    ids=["eight channels", "absurd length", "wrong baud rate", "wrong checksum"],
)
def test_bytes_without_packets_are_named(box, sent, sentence) -> None:
    cell = connect(box)
    with again_and_again(lambda: box.send(sent)), pytest.raises(InputError, match=sentence):
        cell.read(HANG_S)
    cell.close()


def test_a_cable_that_is_pulled_is_named(box) -> None:
    cell = connect(box)
    box.measure(0, WRENCH)
    read(cell, 1)
    box.unplug()
    with pytest.raises(NoDeviceError, match=r"was lost: .*: plug it in|was lost: .*: is it switched on, and free"):
        cell.read(HANG_S)
    cell.close()


def test_a_port_that_cannot_be_opened_is_named(serial_box, tmp_path) -> None:
    with pytest.raises(NoDeviceError, match=f"{tmp_path}/none cannot be opened: .*: is the device plugged in"):
        SerialLine(f"{tmp_path}/none", 115200)
    cell = connect(serial_box)
    with pytest.raises(NoDeviceError, match=r"cannot be opened: .*lock.*: is the device plugged in, and free"):
        SerialLine(serial_box.port, 115200)
    cell.close()
    connect(serial_box).close()


def test_an_address_that_nobody_has_is_named() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with pytest.raises(NoDeviceError, match=rf"127\.0\.0\.1:{port} cannot be reached: .*: is the device switched on"):
        TcpLine("127.0.0.1", port)


def test_a_rate_that_the_line_cannot_carry_is_refused(serial_box) -> None:
    with pytest.raises(InputError, match=r"carries 371 packets a second, not 400: give a smaller rate_hz"):
        connect(serial_box, rate_hz=400)
    assert serial_box.asked in ([], ["AT+GSD=STOP"])
    SerialLine(serial_box.port, 115200).close()  # it was given back


# ---- in the bench's file

SIX = "full_scale = [50.0, 50, 100, 1, 1, 1]\nsigma = [0.1, 0.1, 0.1, 0.001, 0.001, 0.001]\n"
LIMITS = "[limits]\nmax_force_n = 5.0\n"


def reference_of(tmp_path, keys: str) -> Reference:
    path = tmp_path / "bench.toml"
    path.write_text(f'schema = 1\n[reference]\nkind = "m8128"\n{keys}\n{LIMITS}')
    return load_rig(path).reference.open()


def test_a_file_opens_it_turned_to_the_pads_axes(box, tmp_path) -> None:
    where = f'port = "{box.port}"' if box.port else f'host = "127.0.0.1"\ntcp_port = {box.tcp_port}'
    axes = 'axes = ["+y", "-x", "+z"]\narm_mm = [0.0, 0.0, 500.0]\nrate_hz = 50'
    cell = reference_of(tmp_path, f"{where}\n{axes}\n{SIX}")
    assert "AT+SMPF=50" in box.asked
    assert cell.facts.rate_hz == 50
    box.measure(0, np.array([1.0, 2, 3, 0, 0, 0]))
    wrench = read(cell, 1)[0].wrench
    assert wrench == pytest.approx([2, -1, 3, -0.5, -1.0, 0])  # less the moment of (2, -1, 3) at 0.5 m along z
    cell.close()


@pytest.mark.parametrize(
    ("keys", "sentence"),
    [
        (SIX, r"reference\.m8128: give either port, e\.g\."),
        (f'port = "/dev/x"\nhost = "y"\n{SIX}', r"reference\.m8128: give either port, e\.g\."),
        ('port = "/dev/x"', "full_scale"),
        (f'port = "/dev/x"\nrate_hz = 0\n{SIX}', "rate_hz"),
        (f'port = "/dev/none-such"\n{SIX}', "/dev/none-such cannot be opened"),
    ],
)
def test_a_file_that_is_wrong_is_named(tmp_path, keys, sentence) -> None:
    with pytest.raises(RuffiniError, match=sentence):
        reference_of(tmp_path, keys)
