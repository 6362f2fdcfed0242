"""The reference has a line for each verb, option, key of board.toml, message, field and enumerated value."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from ruffini.wire import Schema

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module")
def reference() -> Iterator[Any]:
    sys.path.insert(0, str(DOCS))
    import reference

    yield reference
    sys.path.remove(str(DOCS))


def test_every_verb_and_option_has_a_line_with_a_meaning(reference: Any) -> None:
    page = reference.cli()
    verbs = list(reference.verbs())
    assert len(verbs) > 40
    for name, _, _ in verbs:
        assert re.search(rf"^\| \[`{re.escape(name)}`\]\(#[\w-]+\) \| \S", page, re.M), f"{name} has no help"
    assert re.findall(r"^\| `--[\w-]+`[^|]*\|\s*\|", page, re.M) == []


def test_the_table_of_keys_is_the_parsers(reference: Any) -> None:
    parsed, documented = reference.parsed_keys(), reference.documented_keys()
    assert len(parsed) > 90
    assert parsed - documented == set(), "add them to the table in boards/README.md"
    assert documented - parsed == set(), "the parser does not know them: remove them from boards/README.md"


def sections(page: str) -> dict[str, str]:
    return {part.partition("\n")[0]: part for part in page.split("\n## ")[1:]}


def test_every_message_field_and_value_has_a_line(reference: Any) -> None:
    shown = sections(reference.pages()["messages.md"])
    messages, enums = descriptors()
    assert len(messages) > 30
    for name, fields in {**messages, **enums}.items():
        assert name in shown, f"{name} is missing"
        assert [field for field in fields if f"| `{field}` |" not in shown[name]] == []


def descriptors() -> tuple[dict[str, list[str]], dict[str, list[str]]]:
    """Fields of each message and values of each enumeration of the schema, by name without the package."""
    from google.protobuf.descriptor_pb2 import FileDescriptorSet

    messages: dict[str, list[str]] = {}
    enums: dict[str, list[str]] = {}

    def walk(prefix: str, message: Any) -> None:
        name = f"{prefix}{message.name}"
        messages[name] = [field.name for field in message.field]
        enums.update({f"{name}.{enum.name}": [v.name for v in enum.value] for enum in message.enum_type})
        for nested in message.nested_type:
            walk(f"{name}.", nested)

    for file in FileDescriptorSet.FromString(Schema.own().bytes).file:
        for message in file.message_type if file.package == "ruffini" else ():
            walk("", message)
        enums.update({e.name: [v.name for v in e.value] for e in file.enum_type if file.package == "ruffini"})
    return messages, enums
