"""Protobuf messages from a FileDescriptorSet: no generated module, and old hosts decode new devices."""

from __future__ import annotations

import hashlib
from functools import cache
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError, Message

from ruffini.errors import InputError

TYPE_PREFIX = "MESSAGE_TYPE_"


class Schema:
    """Message classes of one FileDescriptorSet."""

    def __init__(self, descriptor_set: bytes) -> None:
        self.bytes = descriptor_set
        self.sha256 = hashlib.sha256(descriptor_set).digest()
        try:
            files = descriptor_pb2.FileDescriptorSet.FromString(descriptor_set)
            pool = descriptor_pool.DescriptorPool()
            for file in files.file:
                pool.Add(file)
            self._classes = message_factory.GetMessageClassesForFiles([f.name for f in files.file], pool)
            types = pool.FindEnumTypeByName("ruffini.MessageType")
        except (DecodeError, TypeError, KeyError) as error:
            raise InputError(f"the schema cannot be read: {error}") from error
        self._pool = pool
        self.type_numbers: dict[str, int] = {v.name.removeprefix(TYPE_PREFIX): v.number for v in types.values}
        self._type_names = {number: name for name, number in self.type_numbers.items()}

    @staticmethod
    @cache
    def own() -> Schema:
        """The schema that this package was built with."""
        from ruffini.native import native_folder

        return Schema((native_folder() / "ruffini.desc").read_bytes())

    def new(self, name: str, **fields: Any) -> Any:
        """An instance of message `name`, e.g. new("Command", request_id=1)."""
        return self._classes[f"ruffini.{name}"](**fields)

    def has_field(self, message: str, field: str) -> bool:
        """Whether messages of this schema have it; older ones may not."""
        known = self._classes.get(f"ruffini.{message}")
        return known is not None and field in known.DESCRIPTOR.fields_by_name

    def type_name(self, number: int) -> str | None:
        """WRENCH for 4, None for a type that this schema does not know."""
        return self._type_names.get(number)

    def is_result(self, number: int) -> bool:
        """Is it a message of which only the newest counts: about a frame of the camera, or STATUS?"""
        cls = self._class(number)
        return cls is not None and ("stamp" in cls.DESCRIPTOR.fields_by_name or self.type_name(number) == "STATUS")

    def _class(self, number: int) -> Any:
        """MESSAGE_TYPE_AB_CD is the message AbCd; None where the schema has no such message."""
        name = self.type_name(number)
        return self._classes.get("ruffini." + name.title().replace("_", "")) if name else None

    def decode(self, type_number: int, payload: bytes) -> Message | None:
        """The message of a packet; None for an unknown type.

        Raises
        ------
        InputError
            The payload is not that message.
        """
        cls = self._class(type_number)
        if cls is None:
            return None
        try:
            message: Message = cls.FromString(payload)
        except DecodeError as error:
            raise InputError(f"a {self.type_name(type_number)} packet cannot be decoded: {error}") from error
        return message

    def enum_number(self, enum: str, name: str) -> int:
        """The number behind a name, e.g. enum_number("FlagBit", "FLAG_STALE") -> 256."""
        return int(self._pool.FindEnumTypeByName(f"ruffini.{enum}").values_by_name[name].number)

    def enum_names(self, enum: str, mask: int) -> list[str]:
        """Names of the bits of a mask, e.g. enum_names("FlagBit", 4) -> ["FLAG_UNCALIBRATED_Z"]."""
        values = self._pool.FindEnumTypeByName(f"ruffini.{enum}").values
        return [v.name for v in values if v.number and v.number & mask]
