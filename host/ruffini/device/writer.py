"""What a host needs to change a sensor: the lease and, if the sensor requires it, an owner's signature."""

from __future__ import annotations

import getpass
import os
import socket
import sys
from typing import Any

from ruffini.device.line import DEVICE, Line
from ruffini.errors import RefusedError

DOMAIN = b"ruffini command 1"
CHANGES = frozenset(("zero", "set", "flash_begin", "flash_chunk", "flash_commit", "flash_abort", "flash_undo", "lease"))
MAX_WHO = 95


class Writer:
    """One host's lease and signatures on one line. Rules: proto/README.md, "Who may change something"."""

    def __init__(self) -> None:
        self.holder = int.from_bytes(os.urandom(4), "little") | 1
        self._nonce = b""
        self._counter = 0
        self._key: Any = None
        self.has_lease = False

    def forget(self) -> None:
        """Forget lease and challenge after the line was lost."""
        self._nonce, self.has_lease = b"", False

    def prepare(self, sensor: Line, action: str) -> None:
        """Acquire the lease, and a challenge if the sensor requires signatures, before a command that changes it.

        Raises
        ------
        RefusedError
            This host has no key that is enrolled on the sensor, or another host holds the lease.
        """
        if action not in CHANGES or not sensor.schema.has_field("Command", "lease"):
            return
        if sensor.hello.needs_key and not self._nonce:
            self._key = self._key or _signing_key(sensor)
            self._nonce, self._counter = bytes(sensor.checked(challenge={}).nonce), 0
        if action != "lease" and not self.has_lease:
            sensor.checked(lease={"who": _who()})
            self.has_lease = True

    def wrap(self, sensor: Line, action: str, command: bytes) -> tuple[str, bytes]:
        """Type and payload that go over the line for a serialised Command."""
        if not self._nonce or action not in CHANGES:
            return "COMMAND", command
        self._counter += 1
        head = DOMAIN + b"\0" + sensor.hello.device_serial.encode() + b"\0" + self._nonce
        message = head + self._counter.to_bytes(4, "little") + bytes([DEVICE]) + command
        signature = self._key.sign(message).signature
        signed = sensor.schema.new("SignedCommand", command=command, counter=self._counter, signature=signature)
        return "SIGNED_COMMAND", signed.SerializeToString()


def _signing_key(sensor: Line) -> Any:
    from nacl.signing import SigningKey

    from ruffini.calibrate import keys

    for key in keys.known():
        if key.can_sign and key.key_id in sensor.hello.key_ids:
            return SigningKey(keys.secret(key.name))
    raise RefusedError(
        f"{sensor.port}: this sensor is changed by its owners only (keys {', '.join(sensor.hello.key_ids)}): "
        f"put the secret half of one of them in {keys.folder()}"
    )


def _who() -> str:
    """For the person at the other host."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):
        user = str(os.getuid())
    words = " ".join([os.path.basename(sys.argv[0] or "python"), *sys.argv[1:3]])
    return f"{user} at {socket.gethostname()}, process {os.getpid()}: {words}"[:MAX_WHO]
