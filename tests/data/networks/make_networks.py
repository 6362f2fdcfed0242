"""Networks of a few hundred bytes for the tests of firmware/infer: means of B, G and R of a 160 x 120 picture.

    python3 tests/data/networks/make_networks.py [FOLDER]

Needs the package onnx. `means` says blue x 1000, green - red; `nan` no number; `short` has one output where its
metadata name two; `small` takes pictures of 80 x 60 only.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from onnx import TensorProto, helper, numpy_helper

HERE = Path(__file__).parent
METADATA = {
    "ruffini.format": "ruffini-network", "ruffini.format_version": "1", "ruffini.board": "round",
    "ruffini.optics": "test", "ruffini.resolution": "160x120", "ruffini.outputs": "blue_un,green_um",
    "ruffini.low": "0,-50", "ruffini.high": "140000,50",
}  # fmt: skip
MEANS = [[1000.0, 0.0, 0.0], [0.0, 1.0, -1.0]]


def network(nodes: list[Any], constants: dict[str, Any], size: tuple[int, int], n_out: int) -> bytes:
    given = helper.make_tensor_value_info("picture", TensorProto.FLOAT, [1, 3, *size])
    said = helper.make_tensor_value_info("said", TensorProto.FLOAT, [1, n_out])
    tensors = [numpy_helper.from_array(np.array(v, np.float32), name) for name, v in constants.items()]
    graph = helper.make_graph(nodes, "means", [given], [said], tensors)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 11)])
    model.ir_version = 6
    helper.set_model_props(model, METADATA)
    return bytes(model.SerializeToString())


def means(weight: list[list[float]]) -> bytes:
    nodes = [
        helper.make_node("GlobalAveragePool", ["picture"], ["mean"]),
        helper.make_node("Flatten", ["mean"], ["flat"], axis=1),
        helper.make_node("Gemm", ["flat", "weight"], ["said"], transB=1),
    ]
    return network(nodes, {"weight": weight}, (120, 160), len(weight))


def small() -> bytes:
    nodes = [
        helper.make_node("AveragePool", ["picture"], ["mean"], kernel_shape=[30, 40], strides=[30, 40]),
        helper.make_node("Flatten", ["mean"], ["flat"], axis=1),
        helper.make_node("Gemm", ["flat", "weight"], ["said"], transB=1),
    ]
    return network(nodes, {"weight": np.ones((2, 12))}, (60, 80), 2)


def main() -> None:
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else HERE
    files = {"means": means(MEANS), "nan": means([[np.nan] * 3] * 2), "short": means(MEANS[:1]), "small": small()}
    for name, data in files.items():
        (folder / f"{name}.onnx").write_bytes(data)


if __name__ == "__main__":
    main()
