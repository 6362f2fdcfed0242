"""Six-axis force/torque sensors whose interface box sends packets over serial or TCP: Sunrise M8128 and its kin.

Commands are lines such as AT+SMPF=100, answers lines such as ACK+SMPF=100$OK, both ended by CR LF. A packet is 31
bytes: 0xAA 0x55, number of bytes that follow the length (16 bits, big endian: 27), packet number (16 bits, big endian,
wraps around), Fx Fy Fz Mx My Mz (float32, little endian), low byte of the sum of these 24 bytes. The box multiplies by
the matrix of the sensor that it is sold with; units must be N and N m. Tried with the emulated box of
emulated_references.py only: no real box has been tried yet.
"""

from __future__ import annotations

import contextlib
import re
import struct
import time
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ruffini import host_clock
from ruffini.errors import InputError, NoDeviceError, RefusedError, RuffiniError
from ruffini.patience import PATIENCE
from ruffini.rig.byte_line import ByteLine
from ruffini.rig.reference import Facts, Reading

Array = npt.NDArray[np.float64]

TCP_PORT, BAUD, RATE_HZ = 4008, 115200, 100  # as shipped
HEADER = b"\xaa\x55"
HEAD, FORCES = struct.Struct(">2sHH"), struct.Struct("<6f")
PACKET_BYTES = HEAD.size + FORCES.size + 1
LENGTH = PACKET_BYTES - 4  # as a packet states it: without header and length
NUMBERS = 1 << 16  # of packets, before they begin again
STOP, START = "AT+GSD=STOP", "AT+GSD"
SIX_CHANNELS = "AT+SGDM=(A01,A02,A03,A04,A05,A06);E;1;(WMA:1)"  # engineering units, one sample a packet
ANSWER_S = 1.0 * PATIENCE
DRAIN_S = 1.0  # a box that goes on streaming for so long is asked nevertheless
MAX_STRANGE_BYTES = 64 * PACKET_BYTES  # in a row


class Packets:
    """Finds packets in a stream of bytes of which some are lost or damaged, and counts what is missing.

    n_lost : packets missing between those received, by their numbers
    n_not_finite : whole packets dropped because a value is NaN or infinite
    n_strange_bytes : bytes since the last whole packet that belong to none
    other_length : length stated by the last of these that looked like a packet's beginning, None if none did
    """

    def __init__(self) -> None:
        self.n_lost = self.n_not_finite = self.n_strange_bytes = 0
        self.other_length: int | None = None
        self._partial = b""
        self._last: int | None = None
        self._after_jump: int | None = None

    def feed(self, received: bytes) -> list[Array]:
        """Wrenches (6,), N and N m, of the packets that `received` completes."""
        data, at, n_used, wrenches = self._partial + received, 0, 0, list[Array]()
        while (at := data.find(HEADER, at)) >= 0 and len(data) - at >= PACKET_BYTES:
            _, length, number = HEAD.unpack_from(data, at)
            if length != LENGTH or not _is_intact(data[at : at + PACKET_BYTES]):
                self.other_length = length if length != LENGTH else self.other_length
                at += 1  # the header was damaged, or is part of a packet's data
                continue
            wrench = np.array(FORCES.unpack_from(data, at + HEAD.size))
            at = n_used = at + PACKET_BYTES
            self.n_strange_bytes, self.other_length = 0, None
            self._count(number)
            if np.isfinite(wrench).all():
                wrenches.append(wrench)
            else:
                self.n_not_finite += 1
        if at < 0:  # the last byte may begin a header
            at = len(data) - data.endswith(HEADER[:1])
        self.n_strange_bytes += at - n_used
        self._partial = data[at:]
        return wrenches

    def _count(self, number: int) -> None:
        """Count the packets missing before this one.

        The checksum does not cover the number: a jump counts once the next packet confirms it, and a jump back is taken
        for a restarted box.
        """
        expected = number if self._last is None else (self._last + 1) % NUMBERS
        if number == self._after_jump:
            ahead = (number - expected) % NUMBERS
            self.n_lost += ahead if ahead < NUMBERS // 2 else 0
            expected = number
        self._last = expected
        self._after_jump = None if number == expected else (number + 1) % NUMBERS


def _is_intact(packet: bytes) -> bool:
    return sum(packet[HEAD.size : -1]) % 256 == packet[-1]


class PacketCell:
    """A sensor on an open line, which streams at `rate_hz`; closes the line.

    Parameters
    ----------
    line : ByteLine
        The serial port or connection of its box.
    full_scale, sigma : (6,) float64
        Range and standard uncertainty, N and N m, from its certificate.

    Raises
    ------
    NoDeviceError
        The box does not answer, or does not begin to stream.
    RefusedError
        It answers a command with an error.
    InputError
        The line is too slow for the rate.
    """

    def __init__(self, line: ByteLine, full_scale: Array, sigma: Array, *, rate_hz: int = RATE_HZ) -> None:
        self._line, self._name = line, f"force/torque box {line.name}"
        self.facts = Facts(self._name, full_scale, sigma, rate_hz)
        self._packets = Packets()
        self._early = list[Array]()  # received before the first `read`
        self._last_s: float | None = None
        try:
            self._start(rate_hz)
        except BaseException:
            self.close()
            raise

    @property
    def n_lost(self) -> int:
        """Packets without a reading: lost, by their numbers, or with a value that is NaN or infinite."""
        return self._packets.n_lost + self._packets.n_not_finite

    def _start(self, rate_hz: int) -> None:
        if rate_hz * PACKET_BYTES > self._line.bytes_per_s:
            most_hz = int(self._line.bytes_per_s / PACKET_BYTES)
            raise InputError(f"{self._name}: its line carries {most_hz} packets a second, not {rate_hz}: "
                             "give a smaller rate_hz or a larger baud")  # fmt: skip
        self._send(STOP)  # it may still stream for a program that was killed
        drained_s = time.monotonic() + DRAIN_S
        while self._line.receive() and time.monotonic() < drained_s:
            pass
        self._command(f"AT+SMPF={rate_hz}", f"AT+SMPR={rate_hz}", remedy="give a rate_hz that its manual lists")
        self._command(SIX_CHANNELS, remedy="it must send six channels in engineering units: see its manual")
        self._command(START, remedy="see its manual")

    def _send(self, command: str) -> None:
        self._line.send(f"{command}\r\n".encode())

    def _command(self, command: str, older: str = "", *, remedy: str) -> None:
        """Send a command, or the one that older boxes know instead, until one is accepted."""
        answers = {}
        for text in filter(None, (command, older)):
            answer = self._ask(text)
            if answer.endswith("OK"):
                return
            if answer:
                answers[text] = answer
        if not answers:
            raise NoDeviceError(f"{self._name} does not answer {command}: is it switched on, and the address or the "
                                "baud rate right?")  # fmt: skip
        asked, answer = next(iter(answers.items()))
        raise RefusedError(f"{self._name} answers {answer!r} to {asked}: {remedy}")

    def _ask(self, command: str) -> str:
        """Answer to a command, "" if there is none. A packet is an answer to START, too: some boxes give no other."""
        name = command[3:].partition("=")[0]
        answer = re.compile(rb"ACK\+" + name.encode() + rb"[ -~]*(?=\r\n)")
        self._send(command)
        received, deadline = b"", time.monotonic() + ANSWER_S
        while time.monotonic() < deadline:
            new = self._line.receive()
            received += new
            if command == START:
                self._early += self._packets.feed(new)
            if match := answer.search(received):
                return match[0].decode()
            if self._early:
                return "OK"
        return ""

    def read(self, timeout_s: float) -> list[Reading]:
        deadline, n_before = time.monotonic() + timeout_s, self._packets.n_not_finite
        while True:
            wrenches = self._early or self._packets.feed(self._line.receive())
            self._early = []
            if wrenches:
                return self._stamped(wrenches)
            if self._packets.n_strange_bytes > MAX_STRANGE_BYTES:
                raise InputError(self._misunderstood())
            if time.monotonic() < deadline:
                continue
            if self._packets.n_not_finite > n_before:
                raise NoDeviceError(f"{self._name} sends only values that are NaN or infinite: is the sensor plugged "
                                    "into it?")  # fmt: skip
            raise NoDeviceError(f"{self._name} sends nothing for {timeout_s:g} s: is it plugged in?")

    def _misunderstood(self) -> str:
        length, n = self._packets.other_length, self._packets.n_strange_bytes
        if length is not None:
            return (
                f"{self._name} sends packets of length {length} instead of {LENGTH}: check in its manual that "
                f"{SIX_CHANNELS} chooses six floats"
            )
        return f"{self._name} sent {n} bytes without a whole packet: check the cable and the baud rate"

    def _stamped(self, wrenches: Sequence[Array]) -> list[Reading]:
        """Readings of packets received together: at the rate, up to now, and after those before."""
        now, n = host_clock.now(), len(wrenches)
        step_s = 1 / self.facts.rate_hz
        if self._last_s is not None:
            step_s = min(step_s, (now - self._last_s) / n)
        self._last_s = now
        return [
            Reading(now - (n - 1 - i) * step_s, wrench, bool((abs(wrench) >= self.facts.full_scale).any()))
            for i, wrench in enumerate(wrenches)
        ]

    def close(self) -> None:
        with contextlib.suppress(RuffiniError):  # it is gone
            self._send(STOP)
        self._line.close()
