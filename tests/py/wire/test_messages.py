"""Messages by the descriptor set: no generated module, unknown types and hostile payloads."""

from __future__ import annotations

import pytest

from ruffini.errors import InputError
from ruffini.wire.messages import Schema


def test_round_trip_by_the_own_schema() -> None:
    schema = Schema.own()
    command = schema.new("Command", request_id=7, subscribe={"subscriptions": [{"type": 4, "every": 1}]})
    again = schema.decode(schema.type_numbers["COMMAND"], command.SerializeToString())
    assert again is not None
    assert again.subscribe.subscriptions[0].every == 1


def test_a_type_of_the_future_is_none_and_garbage_an_error() -> None:
    schema = Schema.own()
    assert schema.decode(200, b"") is None
    with pytest.raises(InputError, match="WRENCH packet cannot be decoded"):
        schema.decode(schema.type_numbers["WRENCH"], b"\xff\xff\xff")


def test_a_broken_schema_says_so() -> None:
    with pytest.raises(InputError, match="schema cannot be read"):
        Schema(b"\x0a\xff")


def test_flags_by_name() -> None:
    assert Schema.own().enum_names("FlagBit", 5) == ["FLAG_NO_REFERENCE", "FLAG_UNCALIBRATED_Z"]
