"""Golden bytes of the wire, written from proto/README.md alone: shares no code with firmware or host tools.

    python3 proto/vectors/make_vectors.py [FOLDER]     # writes frames.txt and dense.txt

Plain Python, slow and obvious on purpose.
"""

from __future__ import annotations

import sys
from pathlib import Path

HEADER = "# Made by make_vectors.py beside this file; do not edit. Fields are separated by ' | '.\n"


def crc(data: bytes, polynomial: int = 0x82F63B78) -> int:
    """Reflected CRC-32 with the given polynomial, bit by bit; the default is Castagnoli's."""
    value = 0xFFFFFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (polynomial if value & 1 else 0)
    return value ^ 0xFFFFFFFF


def stuff(data: bytes) -> bytes:
    """COBS: cut at the zeros; every piece of 254 bytes stands alone, after 0xFF."""
    out = b""
    for piece in data.split(b"\0"):
        whole, rest = divmod(len(piece), 254)
        for i in range(whole):
            out += b"\xff" + piece[254 * i : 254 * (i + 1)]
        out += bytes([rest + 1]) + piece[254 * whole :]
    return out


def body(
    type_: int, payload: bytes = b"", *, version: int = 1, flags: int = 0, sensor: int = 0, sequence: int = 0,
    fragment: int = 0, fragments: int = 1, length: int | None = None,
) -> bytes:  # fmt: skip
    """Header and payload."""
    n = len(payload) if length is None else length
    head = bytes([version, flags, type_, sensor]) + sequence.to_bytes(4, "little") + bytes([fragment, fragments])
    return head + n.to_bytes(2, "little") + payload


def frame(*args: int | bytes, **fields: int) -> bytes:
    """A whole frame with a right CRC."""
    data = body(*args, **fields)  # type: ignore[arg-type]
    return stuff(data + crc(data).to_bytes(4, "little")) + b"\0"


def said(type_: int, payload: bytes = b"", **fields: int) -> str:
    """The outcome of a frame that is accepted."""
    f = {"flags": 0, "sensor": 0, "sequence": 0, "fragment": 0, "fragments": 1, **fields}
    return (
        f"frame type={type_} flags={f['flags']} sensor={f['sensor']} sequence={f['sequence']} "
        f"fragment={f['fragment']} fragments={f['fragments']} payload={payload.hex()}"
    )


def good_frames() -> list[tuple[str, bytes, str]]:
    out = []

    def add(name: str, type_: int, payload: bytes = b"", **fields: int) -> None:
        out.append((name, frame(type_, payload, **fields), said(type_, payload, **fields)))

    add("hello request", 1, flags=1, sensor=255)
    add("status request", 3, flags=1, sensor=255, sequence=1)
    add("schema request", 2, flags=1, sensor=255, sequence=2)
    # Command{request_id=7, subscribe{{WRENCH every 1}, {FIELD every 4}}}
    add("subscribe", 11, bytes.fromhex("0807120c0a04080410010a0408051004"), flags=1, sensor=255, sequence=3)
    add("zero command", 11, bytes.fromhex("08081a00"), flags=1, sensor=255, sequence=4)
    add("wrench, simulated replay", 4, bytes.fromhex("0a0508e80710011013180f"), flags=6, sequence=5)
    # Contacts{{slip{slip_state=INCIPIENT, ratio 350, friction 500 +- 100, share 620, margin 25000}}}, n_found=1
    add("contact that begins to slip", 7, bytes.fromhex("1214920311080210de0218f403206428ec0430d086031801"), sequence=6)
    add("contact with all that stages add", 7, contact_of_all_stages(), sequence=6)
    add("wrench and how sure it is", 4, wrench_with_covariance(), sequence=7)
    add("field and how sure it is", 5, field_with_sigma(), sequence=8)
    add("what the forces do not explain", 16, residual_of_two_nodes(), sequence=9)
    # Features{capture_us=1000, frame=7; -1, 70000, 0}
    dense = part(2, 3) + part(3, 1) + part(4, 1) + part(5, packed([-1, 70_000, 0]))
    add("features of a wrench", 17, part(1, part(1, 1000) + part(2, 7)) + part(2, dense), sequence=9)
    add("reply ok", 12, bytes.fromhex("0807"), sensor=255, sequence=6)
    add("payload of one zero", 9, b"\0")
    add("payload of zeros", 9, bytes(40))
    add("payload of 0xff", 9, b"\xff" * 40)
    for n in (237, 238, 239, 253, 254, 255, 508):
        add(f"payload of {n} bytes without a zero", 9, bytes(1 + i % 255 for i in range(n)))
    add("largest payload, no zero", 9, b"\x55" * 4048)
    add("largest payload, all zero", 9, bytes(4048))
    add("largest sequence", 4, b"\x01", sequence=0xFFFFFFFF)
    add("first of two fragments", 5, b"ab", sequence=9, fragment=0, fragments=2)
    add("second of two fragments", 5, b"cd", sequence=9, fragment=1, fragments=2)
    add("last of 255 fragments", 5, b"e", sequence=10, fragment=254, fragments=255)
    add("a type of the future", 200, b"?", sequence=11)
    first, second = frame(4, b"\x08", sequence=6), frame(12, b"\x08\x07", sensor=255, sequence=6)
    both = f"{said(4, bytes([8]), sequence=6)}; {said(12, bytes([8, 7]), sensor=255, sequence=6)}"
    out.append(("two frames", first + second, both))
    out.append(("delimiters before and between", b"\0\0" + first + b"\0" + second, both))
    return out


def part(number: int, value: int | bytes) -> bytes:
    """A field of a protobuf message: a varint, or bytes with their length."""
    if isinstance(value, int):
        return varint(number << 3) + varint(value)
    return varint(number << 3 | 2) + varint(len(value)) + value


def varint(value: int) -> bytes:
    out = b""
    while value > 127:
        out, value = out + bytes([value & 127 | 128]), value >> 7
    return out + bytes([value])


def zigzag(value: int) -> int:
    return 2 * value if value >= 0 else -2 * value - 1


def repeated(number: int, values: tuple[int, ...], *, is_signed: bool = True) -> bytes:
    """A repeated number."""
    return part(number, b"".join(varint(zigzag(v) if is_signed else v) for v in values))


def contact_of_all_stages() -> bytes:
    """Every field of every stage's message, each number another one; no board has all the stages."""
    skin = repeated(1, (1, -2, 3)) + repeated(2, (4, -5, 6)) + part(3, 7) + part(4, 8)
    tool = repeated(1, (11, -12, 13)) + repeated(2, (14, -15)) + repeated(3, (16, -17, 18))
    tool += repeated(4, (21, 22, 23, 24, 25, 26, 27), is_signed=False) + part(5, 28) + part(6, 29)
    model = part(1, 1) + part(2, 2) + part(3, 870) + part(4, 31) + part(5, 32) + part(6, 33) + part(7, 34)
    model += part(8, zigzag(-35)) + part(9, 360) + part(10, 37) + part(11, 1) + part(12, 38) + part(13, 39)
    flow = part(1, 41) + part(2, 42) + part(3, zigzag(-43))
    contact = part(7, zigzag(-3000)) + part(9, 1) + part(16, 1) + part(43, flow) + part(51, skin)
    return part(2, contact + part(52, tool) + part(53, model)) + part(3, 1)


# Contact at x = 0, y = -2 mm: sigma 2 uN of fx and fy, 7 uN of fz, carried to the origin; 8, 8 and 3 uN mm of its own.
UPPER = (4, 0, 0, 0, 0, 8, 4, 0, 0, 0, 0, 49, -98, 0, 0, 64 + 196, 0, 0, 64, 0, 9 + 16)


def wrench_with_covariance() -> bytes:
    """fz = -1000 uN, all six valid, the covariance valid."""
    covariance = b"".join(varint(zigzag(v)) for v in UPPER)
    return part(4, zigzag(-1000)) + part(8, b"\1" * 6) + part(9, covariance) + part(10, 1)


def field_with_sigma() -> bytes:
    """Two nodes in steps of 10 uN: (20, -10, -300) +- (7, 7, 25), and no force +- (1, 1, 9)."""

    def dense(values: list[int]) -> bytes:
        return part(2, 2) + part(3, 1) + part(4, 3) + part(5, packed(values))

    force, sigma = dense([20, -10, -300, 0, 0, 0]), dense([7, 7, 25, 1, 1, 9])
    return part(2, 10) + part(3, force) + part(6, b"\1" * 3) + part(8, sigma) + part(9, 1)


def residual_of_two_nodes() -> bytes:
    """In steps of 1/64 standard deviation, valid: (-1, 0.5, 0), and (8, -2, 0.25)."""
    dense = part(2, 2) + part(3, 1) + part(4, 3) + part(5, packed([-64, 32, 0, 512, -128, 16]))
    return part(2, 15_625) + part(3, dense) + part(4, 1)


def bad_frames() -> list[tuple[str, bytes, str]]:
    whole = frame(4, b"\x01\x02\x03", sequence=1)
    data = body(4, b"\x01\x02\x03", sequence=1)
    good = said(4, b"\x01\x02\x03", sequence=1)

    def sealed(data: bytes) -> bytes:
        return stuff(data + crc(data).to_bytes(4, "little")) + b"\0"

    out = [
        ("one bit of the payload", stuff(data[:-1] + b"\x02" + crc(data).to_bytes(4, "little")) + b"\0", "bad_crc"),
        ("the type", stuff(data[:2] + b"\x05" + data[3:] + crc(data).to_bytes(4, "little")) + b"\0", "bad_crc"),
        ("CRC big endian", stuff(data + crc(data).to_bytes(4, "big")) + b"\0", "bad_crc"),
        ("CRC-32 of Ethernet", stuff(data + crc(data, 0xEDB88320).to_bytes(4, "little")) + b"\0", "bad_crc"),
        ("CRC of the payload alone", stuff(data + crc(data[12:]).to_bytes(4, "little")) + b"\0", "bad_crc"),
        ("CRC all zero", stuff(data + bytes(4)) + b"\0", "bad_crc"),
        ("no CRC", stuff(data + b"\1") + b"\0", "bad_crc"),
        ("version 0", sealed(body(4, b"\x01", version=0)), "malformed"),
        ("version 2", sealed(body(4, b"\x01", version=2)), "malformed"),
        ("unknown flag 8", sealed(body(4, b"\x01", flags=8)), "malformed"),
        ("unknown flag 128", sealed(body(4, b"\x01", flags=128)), "malformed"),
        ("length too small", sealed(body(4, b"\x01\x02", length=1)), "malformed"),
        ("length too large", sealed(body(4, b"\x01\x02", length=3)), "malformed"),
        ("length of the largest number", sealed(body(4, b"\x01\x02", length=0xFFFF)), "malformed"),
        ("no fragment", sealed(body(4, b"\x01", fragments=0)), "malformed"),
        ("fragment beyond the last", sealed(body(4, b"\x01", fragment=1, fragments=1)), "malformed"),
        ("fragment 255 of 255", sealed(body(4, b"\x01", fragment=255, fragments=255)), "malformed"),
        ("payload of 4049 bytes", sealed(body(9, b"\x55" * 4049)), "malformed"),
        ("header cut", stuff(data[:7]) + b"\0", "malformed"),
        ("shorter than header and CRC", stuff(bytes(range(1, 16))) + b"\0", "malformed"),
        ("a lone byte", b"\x01\0", "malformed"),
        ("COBS distance beyond the end", b"\x09\x01\x02\0", "malformed"),
        ("COBS 0xff beyond the end", b"\xff\x01\x02\x03\0", "malformed"),
        ("first half lost", whole[9:], "malformed"),
        ("last half lost", whole[:9] + b"\0", "malformed"),
        ("delimiter lost between two frames", whole[:-1] + whole, "bad_crc"),
        ("4096 bytes without a delimiter", b"\x01" * 4096 + b"\0", "oversize"),
        ("a delimiter that never comes", b"\x02" * 9000 + b"\0", "oversize"),
        ("noise, then a frame", b"\x07noise\0" + whole, f"malformed; {good}"),
        ("a broken frame, then a whole one", whole[:5] + b"\x00" + whole, f"malformed; {good}"),
        ("too long, then a frame", b"\x01" * 5000 + b"\0" + whole, f"oversize; {good}"),
    ]  # fmt: skip
    return out


def packed(values: list[int]) -> bytes:
    """Zigzag, blocks of 32, each a width byte and 32 values of that many bits, lowest bit first."""
    out = b""
    for start in range(0, len(values), 32):
        block = [2 * v if v >= 0 else -2 * v - 1 for v in values[start : start + 32]]
        block += [0] * (32 - len(block))
        width = max(v.bit_length() for v in block)
        bits = [v >> i & 1 for v in block for i in range(width)]
        out += bytes([width])
        out += bytes(sum(bit << i for i, bit in enumerate(bits[k : k + 8])) for k in range(0, len(bits), 8))
    return out


def sparse(nodes: list[list[int]]) -> bytes:
    """A bitmap of the nodes that are not zero, lowest bit first, then their values packed."""
    active = [any(node) for node in nodes] + [False] * (-len(nodes) % 8)
    bitmap = bytes(sum(bit << i for i, bit in enumerate(active[k : k + 8])) for k in range(0, len(active), 8))
    return bitmap + packed([v for node in nodes if any(node) for v in node])


def good_dense() -> list[tuple[str, int, int, int, bytes, str]]:
    def ramp(n: int, step: int) -> list[int]:
        return [step * (i - n // 2) or 1 for i in range(n)]

    cases = [
        ("one value", 1, [5]),
        ("both ends of int32", 1, [2147483647, -2147483648, -1, 1]),
        ("exactly one block", 1, ramp(32, 3)),
        ("one value beyond a block", 1, ramp(33, -7)),
        ("three components", 3, ramp(96, 100)),
        ("width 1", 1, [-1] * 64),
        ("small and large blocks", 1, ramp(32, 1) + ramp(32, 1_000_000)),
    ]
    out = [(name, 0, len(v) // c, c, packed(v), ",".join(map(str, v))) for name, c, v in cases]
    for name, nodes in (
        ("sparse, all zero", [[0, 0, 0]] * 20),
        ("sparse, one node", [[0, 0, 0]] * 19 + [[1, -2, 300]]),
        ("sparse, a zero component", [[0, 0, 0], [0, 0, -5]] * 30),
        ("sparse, bitmap of whole bytes", [[7, 7, 7]] * 8 + [[0, 0, 0]] * 8),
    ):
        out.append((name, 1, len(nodes), 3, sparse(nodes), ",".join(str(v) for node in nodes for v in node)))
    return out


def bad_dense() -> list[tuple[str, int, int, int, bytes, str]]:
    one = packed([5])
    return [
        ("empty", 0, 1, 1, b"", "error"),
        ("width byte alone", 0, 1, 1, one[:1], "error"),
        ("truncated block", 0, 1, 1, one[:-1], "error"),
        ("a byte too many", 0, 1, 1, one + b"\0", "error"),
        ("width 33", 0, 1, 1, bytes([33]) + bytes(132), "error"),
        ("second block missing", 0, 33, 1, packed([1] * 32), "error"),
        ("a block too many", 0, 32, 1, packed([1] * 33), "error"),
        ("no bitmap", 1, 9, 1, b"\x01", "error"),
        ("bitmap beyond the last node", 1, 4, 1, b"\x10" + one, "error"),
        ("bitmap without values", 1, 8, 1, b"\x01", "error"),
        ("unknown codec", 2, 1, 1, one, "error"),
        ("no nodes", 0, 0, 1, b"", "error"),
        ("more values than any board has", 0, 4_000_000_000, 3, one, "error"),
    ]


def main() -> None:
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent
    lines = [f"{name} | {data.hex()} | {outcome}\n" for name, data, outcome in good_frames() + bad_frames()]
    (folder / "frames.txt").write_text(
        HEADER + "# name | bytes in hex | what a decoder says, in order\n" + "".join(lines)
    )
    lines = [
        f"{name} | {codec} | {n} | {c} | {data.hex()} | {values}\n"
        for name, codec, n, c, data, values in good_dense() + bad_dense()
    ]
    head = "# name | codec | nodes | components | bytes in hex | values node by node, or error\n"
    (folder / "dense.txt").write_text(HEADER + head + "".join(lines))


if __name__ == "__main__":
    main()
