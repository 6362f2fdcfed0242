"""The host tool's Debian package brings all that the wheel asks for; `make deb` itself needs root."""

from __future__ import annotations

import re
from pathlib import Path

import tomllib

ROOT = Path(__file__).parents[2]
# Where Debian's name is not python3- and the name on PyPI.
DEBIAN = {"opencv-python-headless": "opencv", "pynacl": "nacl", "pyserial": "serial"}


def test_what_the_host_tool_needs_is_in_its_package_or_before_it() -> None:
    project = tomllib.loads((ROOT / "host" / "pyproject.toml").read_text())["project"]
    rules = (ROOT / "firmware" / "deploy" / "packages.cmake").read_text()
    depends = set(re.findall(r"\bpython3-([a-z0-9-]+)", rules.split("HOST_PACKAGE_DEPENDS")[1]))
    vendored = dict(re.findall(r"'([a-z0-9-]+)(>=[0-9.]+)'", (ROOT / ".ci" / "vendor").read_text()))
    for text in project["dependencies"]:
        if "python_version" in text:  # of a Python older than that of the package's Debian
            continue
        name, least = re.match(r"([A-Za-z0-9-]+)(.*)", text).groups()
        if name in vendored:
            assert vendored[name] == least, f"{name}: .ci/vendor and host/pyproject.toml want other versions"
        else:
            assert DEBIAN.get(name, name) in depends, f"{name} is neither vendored nor in the package's Depends"
