"""A trained network as ONNX: one file that OpenCV reads, with its scales inside."""

from __future__ import annotations

import logging
import tempfile
from pathlib import Path

import torch

from ruffini.files import write_whole
from ruffini.train.network import DisplacementNet

NETWORK = "displacement.onnx"
OPSET = 18


def export(net: DisplacementNet, size: tuple[int, int], folder: Path) -> Path:
    """Write the network for pictures of `size` (h, w); returns the file."""
    net.eval()
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)  # it tells of operators that are not used here
    with tempfile.TemporaryDirectory(prefix="ruffini-onnx-") as scratch:
        file = Path(scratch) / NETWORK
        torch.onnx.export(
            net, (torch.zeros(1, 6, *size),), str(file), input_names=["pictures"], output_names=["displacement_um"],
            opset_version=OPSET, dynamo=True, external_data=False, verbose=False,
        )  # fmt: skip
        write_whole(folder / NETWORK, file.read_bytes())
    return folder / NETWORK
