"""Where each fuzzer begins: real inputs, one file each, in FOLDER/<target>; then the inputs that once broke something.

python tests/fuzz/make_corpus.py FOLDER
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import cv2
import numpy as np

from ruffini.boards import find_board
from ruffini.calibrate import container
from ruffini.wire.framing import cobs_decode, encode_message
from ruffini.wire.messages import Schema

ROOT = Path(__file__).parents[2]
TARGETS = ("frame", "dense", "calibration", "board", "session", "slots", "message", "card", "client", "host", "jpeg")
MESSAGES = (11, 1, 3, 4, 7, 10, 12, 13, 15, 14)  # MessageType of each message of message_target.cpp, in its order
TYPE_AT, PAYLOAD_AT, CRC_BYTES = 2, 12, 4  # in a decoded frame
JPEG_SIZE = (32, 24)  # that jpeg_target.cpp takes

# What session_target.cpp does, step by step: its case, then its arguments.
UPLOAD, GOOD_FRAMES, BAD_FRAMES, POLL = [4, 0], [7, 0xA5], [7, 0x1F], [5, 16, 0]
READ, UNDO, QUERY, HANG_UP = [6, 0xFF, 0xFF], [3, 8, 1], [3, 9, 2], [10]
SESSIONS = {
    "confirmed": UPLOAD + GOOD_FRAMES + POLL + READ,
    "reverted": UPLOAD + BAD_FRAMES + POLL + READ,
    "undone": UPLOAD + GOOD_FRAMES + POLL + UPLOAD + GOOD_FRAMES + POLL + UNDO + GOOD_FRAMES + QUERY + READ,
    "undone-on-trial": UPLOAD + UNDO + READ,
    "hang-up": UPLOAD + HANG_UP + GOOD_FRAMES + POLL + READ,
    "signed-and-spoilt": [4, 1, 1, 9, 0, 0, 7, *READ],
    "telemetry": [3, 0, 5, 3, 4, 1, 5, 1, 6, 1, 8, 0, 2, 9, 9, 8, 1, 1, 7, 9, 0, 3, 5, 255, 255, *READ],
    "chunks": [3, 4, 1, 0, 9, 0, 7, 3, 5, 2, 0, 0, 9, 3, 6, 3, *READ],
}
# What slots_target.cpp finds: calls that work, number of files, then the name and the content of each.
SLOTS = {
    "empty": [255, 0],
    "two": [255, 2, 5, 7, 1, 5, 6, 1],
    "trial": [255, 2, 5, 7, 1, 0, 1],
    "spoilt": [255, 2, 5, 7, 3, 1, 0, 99, 0, 4, 5, 6, 1],
    "cut": [255, 1, 5, 7, 3, 1, 0, 99, 0, 255],
    "epoch": [255, 2, 4, 9, 2, 1, 5, 3, 1],
    "few-calls": [3, 1, 5, 7, 1],
}


def unstuffed(data: bytes) -> bytes:
    """A frame without its COBS, which is right."""
    return cobs_decode(data.rstrip(b"\0")) or b""


def write_young_messages(folder: Path, schema: Schema) -> None:
    """SIGNED_COMMAND and TIME, which the vectors do not have: as a message, in a frame, and in a session."""
    zero = schema.new("Command", request_id=7, holder=1, zero={"n_frames": 3}).SerializeToString()
    challenge = schema.new("Command", request_id=6, holder=1, challenge={}).SerializeToString()
    for name, message in (
        ("SIGNED_COMMAND", schema.new("SignedCommand", command=zero, counter=1, signature=bytes(range(64)))),
        ("TIME", schema.new("Time", token=150, received_us=1 << 40, sent_us=(1 << 40) + 1)),
    ):
        number, payload = schema.type_numbers[name], message.SerializeToString()
        frame = encode_message(number, payload, sensor=255, sequence=1)
        (folder / "frame" / name).write_bytes(frame)
        for target in ("host", "client"):
            (folder / target / name).write_bytes(b"\0" + frame)
        (folder / "message" / name).write_bytes(bytes([MESSAGES.index(number)]) + payload)
        asked = bytes([2, len(challenge)]) + challenge + bytes([1, 1, number, 255, 0, 1, len(payload)]) + payload
        (folder / "session" / name).write_bytes(asked + bytes(READ))


def main(folder: Path) -> None:
    for target in TARGETS:
        (folder / target).mkdir(parents=True, exist_ok=True)
    schema = Schema.own()
    types = sorted(schema.type_numbers.values())
    write_young_messages(folder, schema)
    for i, line in enumerate((ROOT / "proto/vectors/frames.txt").read_text().splitlines()):
        if line.startswith("#"):
            continue
        data = bytes.fromhex(line.split(" | ")[1])
        (folder / "frame" / f"{i:03d}").write_bytes(data)
        for target in ("host", "client"):
            (folder / target / f"{i:03d}").write_bytes(b"\0" + data)
        raw = unstuffed(data) if data.count(0) == 1 else b""
        if len(raw) >= PAYLOAD_AT + CRC_BYTES and raw[TYPE_AT] in MESSAGES:
            kind = bytes([MESSAGES.index(raw[TYPE_AT])])
            (folder / "message" / f"{i:03d}").write_bytes(kind + raw[PAYLOAD_AT:-CRC_BYTES])
        if len(raw) >= PAYLOAD_AT + CRC_BYTES and raw[TYPE_AT] in types:
            how = 128 + (types.index(raw[TYPE_AT]) - 128) % len(types)
            (folder / "host" / f"payload-{i:03d}").write_bytes(bytes([how]) + raw[PAYLOAD_AT:-CRC_BYTES])
            (folder / "client" / f"payload-{i:03d}").write_bytes(
                raw[TYPE_AT : TYPE_AT + 1] + raw[PAYLOAD_AT:-CRC_BYTES]
            )
    for i, line in enumerate((ROOT / "proto/vectors/dense.txt").read_text().splitlines()):
        if not line.startswith("#") and line.split(" | ")[5] != "error":
            values = np.array(line.split(" | ")[5].split(","), np.int64).astype("<i4")
            (folder / "dense" / f"{i:03d}").write_bytes(bytes([int(line.split(" | ")[3]) - 1]) + values.tobytes())
    for board in (ROOT / "boards").glob("*/board.toml"):
        (folder / "board" / board.parent.name).write_bytes(board.read_bytes())
    for i, how in enumerate(([], [cv2.IMWRITE_JPEG_RST_INTERVAL, 1], [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])):
        picture = np.add.outer(np.arange(JPEG_SIZE[1]), np.arange(JPEG_SIZE[0]))[..., None] * (3, 4, 5)
        _, data = cv2.imencode(".jpg", picture.astype(np.uint8), how)
        (folder / "jpeg" / f"{i:03d}").write_bytes(data.tobytes())
    for network in (ROOT / "tests/data/networks").glob("*.onnx"):
        shutil.copy(network, folder / "card")
    tensors = {"operator.entry": np.ones((4, 32), np.int16), "operator.shift": np.zeros((4, 1), np.uint8)}
    metadata = {**container.base_metadata(find_board("gelslim")), "operator.out_shift": "4"}
    (folder / "calibration" / "small").write_bytes(container.pack(tensors, metadata).data)
    for steps, target in ((SESSIONS, "session"), (SLOTS, "slots")):
        for name, step in steps.items():
            (folder / target / name).write_bytes(bytes(step))
    for found in (ROOT / "tests/fuzz/found").glob("*/*"):
        shutil.copy(found, folder / found.parent.name)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
