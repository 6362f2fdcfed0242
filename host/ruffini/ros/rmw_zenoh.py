"""Publishing to ROS 2 nodes that use rmw_zenoh, straight through zenoh: keys, liveliness tokens and attachments as
rmw_zenoh's design document and sources state them.

A topic's key is DOMAIN/TOPIC/PKG::msg::dds_::TYPE_/HASH. A publisher is seen (`ros2 topic list`) by a liveliness token.
Each sample has an attachment: its number, its time and the publisher's id, 33 bytes.
"""

from __future__ import annotations

import hashlib
import os
import struct
import time
from pathlib import Path
from typing import Any

from ruffini.errors import InputError
from ruffini.extras import missing
from ruffini.ros.cdr import Types
from ruffini.ros.messages import Message, Topic

LOCAL_ROUTER = "tcp/localhost:7447"  # where rmw_zenohd listens
GID_BYTES = 16
_ATTACHMENT = struct.Struct(f"<qqB{GID_BYTES}s")  # zenoh's serialisation: arrays with their length before them


def dds_type(type_: str) -> str:
    """`pkg/msg/Name` as DDS names it."""
    package, kind, name = type_.split("/")
    return f"{package}::{kind}::dds_::{name}_"


def topic_key(domain: int, topic: str, type_: str, hash_: str) -> str:
    """Where samples of a topic are put; `topic` is a full name, e.g. /pad/wrench."""
    return f"{domain}/{topic.strip('/')}/{dds_type(type_)}/{hash_}"


def mangled(name: str) -> str:
    """A name as one part of a key."""
    return name.replace("/", "%")


def qos_key(topic: Topic) -> str:
    """Quality of service: what differs from rmw_zenoh's default (reliable, volatile, keep the last 42)."""
    return f"{'' if topic.is_reliable else 2}::,{topic.depth}:,:,:,,"


def node_token(domain: int, zid: str, node: str) -> str:
    """Liveliness token of a node in the root namespace, without an enclave."""
    return f"@ros2_lv/{domain}/{zid}/0/0/NN/%/%/{mangled(node)}"


def namesakes_key(domain: int, node: str) -> str:
    """Tokens of all nodes of this name in the root namespace, of any process."""
    return f"@ros2_lv/{domain}/*/*/*/NN/*/%/{mangled(node)}"


def publisher_token(domain: int, zid: str, number: int, node: str, name: str, topic: Topic, hash_: str) -> str:
    """Liveliness token of a publisher; `name` is the topic's full name."""
    parts = (mangled(name), dds_type(topic.type), hash_, qos_key(topic))
    return f"@ros2_lv/{domain}/{zid}/0/{number}/MP/%/%/{mangled(node)}/" + "/".join(parts)


def attachment(number: int, time_ns: int, gid: bytes) -> bytes:
    """What goes beside a sample: from 1, system time, 16 bytes."""
    return _ATTACHMENT.pack(number, time_ns, GID_BYTES, gid)


def configuration(connect: list[str], listen: list[str]) -> Any:
    """A peer that finds others through a router, as rmw_zenoh's nodes do; ZENOH_SESSION_CONFIG_URI wins.

    Raises
    ------
    InputError
        The extra [ros] is not installed, or the file makes no sense.
    """
    try:
        import zenoh
    except ImportError as error:
        raise missing("ROS 2", "ros") from error
    if path := os.environ.get("ZENOH_SESSION_CONFIG_URI"):
        try:
            return zenoh.Config.from_file(Path(path))
        except Exception as error:
            raise InputError(f"ZENOH_SESSION_CONFIG_URI={path}: {error}") from error

    def listed(endpoints: list[str]) -> str:
        return "[" + ",".join(f'"{e}"' for e in endpoints) + "]"

    config = zenoh.Config()
    config.insert_json5("mode", '"peer"')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("connect/endpoints", listed(connect))
    config.insert_json5("connect/timeout_ms", "-1")  # a router that starts later is found
    config.insert_json5("connect/exit_on_failure", "false")
    config.insert_json5("listen/endpoints", listed(listen or ["tcp/localhost:0"]))
    return config


class ZenohNode:
    """A node that publishes; use as a context manager."""

    def __init__(self, node: str, config: Any, *, domain: int = 0) -> None:
        import zenoh

        self._types, self._node, self._domain = Types(), node, domain
        try:
            self._session: Any = zenoh.open(config)
        except Exception as error:
            raise InputError(f"zenoh does not start: {error}") from error
        self._zid = str(self._session.zid())
        self._publishers: dict[str, tuple[Any, bytes]] = {}
        self._numbers: dict[str, int] = {}
        alive = self._session.liveliness()
        self._namesakes: set[str] = set()
        self._watch = alive.declare_subscriber(namesakes_key(domain, node), self._see, history=True)
        self._tokens = [alive.declare_token(node_token(domain, self._zid, node))]

    def __enter__(self) -> ZenohNode:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave the graph."""
        self._session.close()

    def _see(self, sample: Any) -> None:
        import zenoh

        token = str(sample.key_expr)
        if token.split("/")[2] != self._zid:
            is_there = sample.kind == zenoh.SampleKind.PUT
            (self._namesakes.add if is_there else self._namesakes.discard)(token)

    def n_namesakes(self) -> int:
        """Other nodes of this name in the graph."""
        return len(self._namesakes)

    def advertise(self, name: str, topic: Topic) -> None:
        """Be seen as a publisher of the topic `name`."""
        import zenoh

        hash_ = self._types.hash(topic.type)
        number = len(self._publishers) + 1
        token = publisher_token(self._domain, self._zid, number, self._node, name, topic, hash_)
        gid = hashlib.blake2b(token.encode(), digest_size=GID_BYTES).digest()  # anything that nobody else has
        publisher = self._session.declare_publisher(
            topic_key(self._domain, name, topic.type, hash_), congestion_control=zenoh.CongestionControl.DROP
        )
        self._publishers[name], self._numbers[name] = (publisher, gid), 0
        self._tokens.append(self._session.liveliness().declare_token(token))

    def publish(self, name: str, message: Message) -> None:
        """Send on a topic that was advertised."""
        publisher, gid = self._publishers[name]
        self._numbers[name] += 1
        publisher.put(self._types.encode(message), attachment=attachment(self._numbers[name], time.time_ns(), gid))
