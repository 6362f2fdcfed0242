"""The C++ client's enums have every value of ruffini.proto, under its name."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from ruffini.wire import Schema

HEADERS = Path(__file__).parents[3] / "host" / "cpp" / "include" / "ruffini" / "client"
# C++ enum, its header, the enum of ruffini.proto, and how values begin there and here; zero of a mask has no name here.
ENUMS = [
    ("Flag", "messages.h", "FlagBit", "FLAG_", "kFlag"),
    ("HealthBit", "messages.h", "HealthBit", "HEALTH_", "kHealth"),
    ("ReplyCode", "messages.h", "ReplyCode", "REPLY_", "kReply"),
    ("Type", "decoder.h", "MessageType", "MESSAGE_TYPE_", "k"),
    ("Validity", "messages.h", "Validity", "VALIDITY_", "k"),
    ("SlipState", "messages.h", "SlipState", "SLIP_STATE_", "k"),
    ("ContactKind", "messages.h", "ContactKind", "CONTACT_KIND_", "k"),
]  # fmt: skip
UNNAMED = {"FLAG_NONE", "HEALTH_OK", "MESSAGE_TYPE_NONE"}


@pytest.mark.parametrize(("name", "header", "theirs", "prefix", "ours"), ENUMS, ids=[e[0] for e in ENUMS])
def test_an_enum_is_complete(name: str, header: str, theirs: str, prefix: str, ours: str) -> None:
    text = (HEADERS / header).read_text()
    body = re.search(rf"enum (?:class )?{name} : \w+ {{(.*?)}};", text, re.S)
    assert body is not None
    here = {value: int(number) for value, number in re.findall(r"(k\w+) = (\d+)", body[1])}
    values = Schema.own().new("Status").DESCRIPTOR.file.enum_types_by_name[theirs].values
    want = {
        ours + value.name.removeprefix(prefix).title().replace("_", ""): value.number
        for value in values
        if value.name not in UNNAMED
    }
    assert here == want
