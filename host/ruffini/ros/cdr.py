"""Messages as CDR bytes and type hashes, by rosbags' type system: no ROS install is asked for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ruffini.extras import missing
from ruffini.ros.messages import Message

SOURCES = Path(__file__).parent / "ruffini_msgs"  # a ROS package: copy it into a workspace


class Types:
    """ROS 2 types (Jazzy's; those used here are the same from Iron to Lyrical) with ruffini_msgs among them.

    Raises
    ------
    InputError
        The extra [ros] is not installed.
    """

    def __init__(self) -> None:
        try:
            from rosbags.typesys import Stores, get_types_from_msg, get_typestore
        except ImportError as error:
            raise missing("ROS 2", "ros") from error
        self.store: Any = get_typestore(Stores.ROS2_JAZZY)
        for path in sorted(SOURCES.glob("msg/*.msg")):
            self.store.register(get_types_from_msg(path.read_text(), f"ruffini_msgs/msg/{path.stem}"))

    def hash(self, type_: str) -> str:
        """RIHS01 hash of a type, as `ros2 topic info -v` prints it."""
        return str(self.store.hash_rihs01(type_))

    def encode(self, message: Message) -> bytes:
        """CDR, little endian, with its four bytes before it."""
        return bytes(self.store.serialize_cdr(self._made(message), message.type))

    def decode(self, data: bytes, type_: str) -> Any:
        """The inverse, as rosbags' own objects."""
        return self.store.deserialize_cdr(data, type_)

    def _made(self, value: Any) -> Any:
        if isinstance(value, Message):
            return self.store.types[value.type](**{name: self._made(part) for name, part in value.fields.items()})
        if isinstance(value, bytes):
            return np.frombuffer(value, np.uint8)
        return [self._made(part) for part in value] if isinstance(value, list) else value
