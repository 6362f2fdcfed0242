"""Messages by the descriptor set: no generated module, unknown types and hostile payloads."""

from __future__ import annotations

import contextlib

import pytest
from google.protobuf import descriptor_pb2
from hypothesis import given
from hypothesis import strategies as st

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


@given(st.data())
def test_a_spoilt_schema_is_an_error_or_a_schema(data: st.DataObject) -> None:
    spoilt = bytearray(Schema.own().bytes)
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(spoilt) - 1))
        spoilt[at : at + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=3))
    with contextlib.suppress(InputError):
        schema = Schema(bytes(spoilt))
        for number in schema.type_numbers.values():
            with contextlib.suppress(InputError):
                schema.decode(number, b"\x08\x01")


@given(st.integers(0, 14), st.binary(max_size=200))
def test_hostile_payloads_are_an_error_or_a_message(type_number: int, payload: bytes) -> None:
    with contextlib.suppress(InputError):
        Schema.own().decode(type_number, payload)


def test_a_type_of_two_words_finds_its_message() -> None:
    files = descriptor_pb2.FileDescriptorSet.FromString(Schema.own().bytes)
    files.file[0].message_type.add(name="SlipMap").field.add(name="risk", number=1, type=13, label=1)
    types = next(e for e in files.file[0].enum_type if e.name == "MessageType")
    types.value.add(name="MESSAGE_TYPE_SLIP_MAP", number=40)
    message = Schema(files.SerializeToString()).decode(40, b"\x08\x05")
    assert message is not None
    assert message.risk == 5  # type: ignore[attr-defined]


def test_flags_by_name() -> None:
    assert Schema.own().enum_names("FlagBit", 5) == ["FLAG_NO_REFERENCE", "FLAG_UNCALIBRATED_Z"]
