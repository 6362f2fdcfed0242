"""The stereo paper's network as ONNX that OpenCV 4.6 and later runs: batch norm folded, every scale inside.

What the board needs to know of it stands in the file's metadata (proto/NETWORK.md), which the firmware reads.
"""

from __future__ import annotations

import json
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import nn

from ruffini.boards import Board
from ruffini.errors import VerifyError
from ruffini.files import write_whole
from ruffini.older_python import UTC
from ruffini.train.stereo_frames import BINARY_LEVEL, GREY, OUTPUTS, ROI_COLUMNS, ROI_ROWS, Samples
from ruffini.train.stereo_network import HALF_RANGE, StereoNet
from ruffini.train.stereo_predict import StereoNetwork
from ruffini.version import __version__

Array = npt.NDArray[np.float64]

OPSET, IR_VERSION = 11, 6  # old enough for every OpenCV that runs on a board
MARGIN = 0.05  # of a label's range, beyond which a value was not taught
TOLERANCE = 1e-3  # of a label's range, between PyTorch and OpenCV


class _Graph:
    """Nodes one after the other; each takes the last one's output unless it is told."""

    def __init__(self, given: str) -> None:
        from onnx import helper, numpy_helper

        self._node, self._tensor = helper.make_node, numpy_helper.from_array
        self.nodes: list[Any] = []
        self.constants: list[Any] = []
        self.last = given

    def constant(self, value: npt.ArrayLike, dtype: Any = np.float32) -> str:
        name = f"c{len(self.constants)}"
        self.constants.append(self._tensor(np.ascontiguousarray(value, dtype=dtype), name))
        return name

    def add(self, kind: str, *constants: str, given: list[str] | None = None, **attributes: Any) -> str:
        name = f"n{len(self.nodes)}"
        self.nodes.append(self._node(kind, [*(given or [self.last]), *constants], [name], **attributes))
        self.last = name
        return name

    def conv(self, weight: npt.ArrayLike, bias: npt.ArrayLike) -> str:
        size = np.shape(weight)[2]
        return self.add("Conv", self.constant(weight), self.constant(bias), kernel_shape=[size, size],
                        pads=[size // 2] * 4)  # fmt: skip

    def part(self, begin: list[int], end: list[int], given: str) -> str:
        """Rows and columns."""
        whole = [self.constant(v, np.int64) for v in (begin, end, [2, 3])]
        return self.add("Slice", *whole, given=[given])


def folded(conv: nn.Conv2d, norm: nn.BatchNorm2d) -> tuple[Array, Array]:
    """Weight and bias of a convolution and the batch norm behind it, as one."""
    gain = norm.weight / torch.sqrt(norm.running_var + norm.eps)
    weight = conv.weight * gain[:, None, None, None]
    bias = (conv.bias - norm.running_mean) * gain + norm.bias
    return weight.detach().numpy(), bias.detach().numpy()


def onnx_of(net: StereoNet, board: Board, metadata: dict[str, str]) -> bytes:
    """The network for whole frames of `board`."""
    from onnx import TensorProto, helper

    height, width = board.camera.height_px, board.camera.width_px
    graph = _Graph("picture")
    grey = graph.conv(np.array(GREY).reshape(1, 3, 1, 1), [0.0])
    rows, columns = ROI_ROWS, ROI_COLUMNS
    left = graph.part([rows.start, columns.start], [rows.stop, columns.stop], grey)
    mix = net.mix.numpy()
    if net.mode in (0, 2):
        mix = mix[:, :1]
    else:
        right = graph.part([rows.start, columns.start + width // 2], [rows.stop, columns.stop + width // 2], grey)
        graph.add("Concat", given=[left, right], axis=1)
    if net.mode >= 2:
        n = mix.shape[1]  # OpenCV 4.6 reads no Clip: clip(x, 0, 1) = relu(x) - relu(x - 1)
        twice = np.concatenate([np.eye(n), np.eye(n)])[:, :, None, None]
        graph.conv(twice, [-BINARY_LEVEL] * n + [-BINARY_LEVEL - 1] * n)
        graph.add("Relu")
        mix = 2 * HALF_RANGE * np.concatenate([mix, -mix], axis=1)
    graph.conv(mix[:, :, None, None], [-1.0] * 3)
    if net.plan.is_halved:
        graph.add("AveragePool", kernel_shape=[2, 2], strides=[2, 2])
    layers = list(net.trunk)
    for i, layer in enumerate(layers):
        if isinstance(layer, nn.Conv2d):
            graph.conv(*folded(layer, layers[i + 1]))
        elif isinstance(layer, nn.ReLU):
            graph.add("Relu")
        elif isinstance(layer, nn.MaxPool2d):
            graph.add("MaxPool", kernel_shape=[2, 2], strides=[2, 2])
    graph.add("Flatten", axis=1)
    dense, norm = [layer for layer in net.head if isinstance(layer, nn.Linear)], net.head[0]
    for layer in dense:
        weight, bias = layer.weight.detach(), layer.bias.detach()
        if layer is dense[0]:
            weight = weight / torch.sqrt(norm.running_var + norm.eps)
            bias = bias - weight @ norm.running_mean
        if layer is dense[-1]:
            weight, bias = weight * net.span[:, None], bias * net.span + net.low
        graph.add("Gemm", graph.constant(weight.numpy()), graph.constant(bias.numpy()), transB=1)
        if layer is not dense[-1]:
            graph.add("Relu")
    made = helper.make_graph(
        graph.nodes, "stereo",
        [helper.make_tensor_value_info("picture", TensorProto.FLOAT, [1, 3, height, width])],
        [helper.make_tensor_value_info(graph.last, TensorProto.FLOAT, [1, len(OUTPUTS)])], graph.constants,
    )  # fmt: skip
    model = helper.make_model(made, opset_imports=[helper.make_opsetid("", OPSET)], producer_name="ruffini")
    model.ir_version = IR_VERSION
    helper.set_model_props(model, metadata)
    return bytes(model.SerializeToString())


def metadata_of(net: StereoNet, board: Board, samples: Samples, simulated: bool) -> dict[str, str]:
    """What the firmware and a person read beside the network."""
    taught = samples.range_of(board.contact.threshold_un)
    low, high = taught[:, 0].copy(), taught[:, 1]
    span = high - low
    low[1:] -= MARGIN * span[1:]  # of the force it is what counts as a touch
    return {
        "ruffini.format": "ruffini-network", "ruffini.format_version": "1", "ruffini.board": board.name,
        "ruffini.optics": board.camera.optics,
        "ruffini.resolution": f"{board.camera.width_px}x{board.camera.height_px}",
        "ruffini.outputs": ",".join(OUTPUTS),
        "ruffini.low": ",".join(str(round(v)) for v in low),
        "ruffini.high": ",".join(str(round(v)) for v in high + MARGIN * span),
        "ruffini.inputs_sha256": samples.digest(), "ruffini.tool_version": __version__,
        "ruffini.created_utc": datetime.now(UTC).isoformat(timespec="seconds"),
        "ruffini.simulated": json.dumps(simulated),
        "ruffini.plan": net.plan.name, "ruffini.mode": str(net.mode),
    }  # fmt: skip


def export(
    net: StereoNet, board: Board, samples: Samples, pictures: list[npt.NDArray[np.uint8]], path: Path, simulated: bool
) -> float:
    """Write the network, run it by OpenCV on whole frames, and say how far PyTorch is from that, over labels' ranges.

    Raises
    ------
    VerifyError
        OpenCV gives other numbers than PyTorch.
    """
    net.eval()
    write_whole(path, onnx_of(net, board, metadata_of(net, board, samples, simulated)))
    ours = StereoNetwork(path, board)
    worst = 0.0
    with torch.no_grad():
        for picture in pictures:
            given = torch.from_numpy(np.moveaxis(picture, -1, 0)[None].astype(np.float32))
            off = np.abs(net(given)[0].numpy() - ours.raw(picture)) / net.span.numpy()
            worst = max(worst, float(off.max()))
    if not worst <= TOLERANCE:
        raise VerifyError(
            f"{path}: OpenCV is {worst:.2g} of a label's range off PyTorch, at most {TOLERANCE:g} is right"
        )
    return worst
