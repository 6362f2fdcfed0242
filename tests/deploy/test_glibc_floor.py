"""The check of a wheel's tag against what its native parts need, on programs of this system in their place."""

from __future__ import annotations

import re
import shutil
import subprocess
import zipfile
from pathlib import Path

import pytest

from ruffini.daemon import find_daemon

CHECK = Path(__file__).parents[2] / ".ci/glibc-floor"
TRUE = shutil.which("true")


def checked(wheel: Path, *natives: Path | str | None) -> tuple[int, str]:
    with zipfile.ZipFile(wheel, "w") as file:
        for name, native in zip(("libruffini.so", "ruffinid"), natives, strict=False):
            assert native is not None
            file.write(native, f"ruffini/_native/{name}")
    done = subprocess.run([CHECK, wheel], capture_output=True, text=True, check=False)
    return done.returncode, done.stdout + done.stderr


def test_what_the_tag_promises_is_enough_or_refused(tmp_path: Path) -> None:
    code, said = checked(tmp_path / "ruffini-1-py3-none-manylinux_9_9_x86_64.whl", TRUE, TRUE)
    needed = re.fullmatch(r"needs glibc (2\.\d+)\n", said)
    assert code == 0
    assert needed
    old = tmp_path / "ruffini-1-py3-none-manylinux_2_2_x86_64.whl"
    assert checked(old, TRUE, TRUE) == (1, f"glibc-floor: {old} needs glibc {needed[1]}, its tag promises 2.2\n")


# ruffinid of the build tree links shared libraries.
@pytest.mark.parametrize(
    ("tag", "natives", "said"),
    [
        ("linux_x86_64", (TRUE, TRUE), "has no tag manylinux_X_Y"),
        ("manylinux_9_9_x86_64", (TRUE,), "holds 1 native parts, not libruffini.so and ruffinid"),
        (
            "manylinux_9_9_x86_64",
            (TRUE, find_daemon()),
            "ruffinid needs lib",
        ),
    ],
)
def test_other_wheels_are_refused(tmp_path: Path, tag: str, natives: tuple[Path | str | None, ...], said: str) -> None:
    code, text = checked(tmp_path / f"ruffini-1-py3-none-{tag}.whl", *natives)
    assert (code, said in text) == (1, True), text
