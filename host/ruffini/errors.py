"""Errors of ruffini. Each message says what happened, on what, and what to do."""

import sys


class RuffiniError(Exception):
    """Base of all errors that a user of the package may want to catch.

    The message is one line that is safe to print, also where it quotes a spoilt file: what does not print is escaped.
    """

    exit_code = 1

    def __init__(self, message: str = "") -> None:
        super().__init__("".join(c if c.isprintable() else ascii(c)[1:-1] for c in message))

    if sys.version_info < (3, 11):

        def add_note(self, note: str) -> None:
            """What newer exceptions have."""
            self.__notes__ = [*getattr(self, "__notes__", ()), note]


class InputError(RuffiniError, ValueError):
    """A file, an array or a setting that does not make sense (exit code 2)."""

    exit_code = 2


class NoDeviceError(RuffiniError):
    """No device, or the port is busy (exit code 3)."""

    exit_code = 3


class LineLostError(NoDeviceError):
    """The line broke while it was used: unplugged, or the other end is gone."""


class SeveralDevicesError(RuffiniError):
    """Several devices where one is needed: the user must choose (exit code 2)."""

    exit_code = 2


class RefusedError(RuffiniError):
    """The device, or a safety check, said no (exit code 4)."""

    exit_code = 4


class VerifyError(RuffiniError):
    """What was read back is not what was written, or a signature is wrong (exit code 5)."""

    exit_code = 5
