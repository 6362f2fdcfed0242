"""The stereo paper's network: VGG16 with batch norm, two dense layers, one regression for all labels.

    input    (n, 3, h, w) grey levels 0 to 255, B G R, two views side by side, as the camera gives them
    output   (n, 6) in the units of stereo_frames.OUTPUTS

Region, grey, input mode, scaling to [-1, 1] and the labels' scales (eq. 1) are inside: an exported file needs nothing
beside it. The paper's modes: 0 left, 1 left and right, 2 left binarised, 3 both binarised. Not in paper: VGG16's
three channels are left, mean and right, or three times left (the paper does not say), and features are standardised
before the dense layers, for what a press changes in a picture is small beside the picture.
"""

from __future__ import annotations

import pickle
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import nn

from ruffini.errors import InputError
from ruffini.train.stereo_frames import BINARY_LEVEL, GREY, ROI_COLUMNS, ROI_ROWS

Array = npt.NDArray[np.float64]

HALF_RANGE = 127.5
POOLS = 5
WEIGHTS_NAME = "vgg16_bn-*.pth"  # as torchvision keeps them


@dataclass(frozen=True)
class Plan:
    """Layers of a network. widths : channels of the five blocks of 2, 2, 3, 3 and 3 convolutions; is_halved : pictures
    are halved before the first block instead of behind the last.
    """

    name: str
    widths: tuple[int, int, int, int, int]
    units: int
    dropout: float
    is_halved: bool


PLANS = {
    "vgg16": Plan("vgg16", (64, 128, 256, 512, 512), 4096, 0.9, False),
    # VGG16's layers an eighth as wide, on half the resolution: what a processor trains from nothing.
    "eighth": Plan("eighth", (8, 16, 32, 64, 64), 512, 0.0, True),
}
DEPTHS = (2, 2, 3, 3, 3)


def trunk_of(plan: Plan) -> nn.Sequential:
    """Convolutions, numbered as torchvision numbers VGG16's."""
    layers: list[Any] = []
    width = 3
    for n_out, depth in zip(plan.widths, DEPTHS, strict=True):
        for _ in range(depth):
            layers += [nn.Conv2d(width, n_out, 3, padding=1), nn.BatchNorm2d(n_out), nn.ReLU()]
            width = n_out
        layers.append(nn.MaxPool2d(2, 2))
    return nn.Sequential(*(layers[:-1] if plan.is_halved else layers))


class StereoNet(nn.Module):
    """See above. low, high (6,): range of the labels."""

    def __init__(self, plan: Plan, mode: int, low: Array, high: Array) -> None:
        super().__init__()
        self.plan, self.mode = plan, mode
        self.trunk = trunk_of(plan).to(memory_format=torch.channels_last)  # faster by two thirds
        cells = (ROI_ROWS.stop - ROI_ROWS.start >> POOLS) * (ROI_COLUMNS.stop - ROI_COLUMNS.start >> POOLS)
        self.head = nn.Sequential(
            nn.BatchNorm1d(plan.widths[-1] * cells, affine=False),
            nn.Linear(plan.widths[-1] * cells, plan.units),
            nn.ReLU(),
            nn.Dropout(plan.dropout),
            nn.Linear(plan.units, plan.units),
            nn.ReLU(),
            nn.Dropout(plan.dropout),
            nn.Linear(plan.units, len(low)),
        )
        self.register_buffer("low", torch.tensor(low, dtype=torch.float32))
        self.register_buffer("span", torch.tensor(high - low, dtype=torch.float32))
        self.register_buffer("mix", mix_of(mode))

    def channels(self, views: torch.Tensor) -> torch.Tensor:
        """Three channels in [-1, 1] of grey views (n, 2, 192, 224), 0 to 255."""
        if self.mode >= 2:
            views = 2 * HALF_RANGE * torch.clamp(views - BINARY_LEVEL, 0, 1)  # of whole grey levels 0 or 1
        channels = torch.einsum("ov,nvhw->nohw", self.mix, views) - 1
        return nn.functional.avg_pool2d(channels, 2) if self.plan.is_halved else channels

    def features(self, views: torch.Tensor) -> torch.Tensor:
        return self.trunk(self.channels(views).contiguous(memory_format=torch.channels_last)).flatten(1)

    def from_views(self, views: torch.Tensor) -> torch.Tensor:
        """Labels scaled to [0, 1]."""
        return self.head(self.features(views))

    def forward(self, pictures: torch.Tensor) -> torch.Tensor:
        grey = torch.einsum("c,nchw->nhw", torch.tensor(GREY), pictures)
        width = grey.shape[-1] // 2
        both = (grey[:, ROI_ROWS, ROI_COLUMNS], grey[:, :, width:][:, ROI_ROWS, ROI_COLUMNS])
        return self.from_views(torch.stack(both, dim=1)) * self.span + self.low


def mix_of(mode: int) -> torch.Tensor:
    """From two views to three channels, (3, 2), grey levels to a range of 2."""
    parts = [[1.0, 0.0]] * 3 if mode in (0, 2) else [[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]]
    return torch.tensor(parts) / HALF_RANGE


def find_weights(path: Path | None) -> Path | None:
    """torchvision's VGG16 with batch norm: the file that is named, else the one in torchvision's cache, else none."""
    if path is not None:
        return path
    return next(iter(sorted(Path(torch.hub.get_dir(), "checkpoints").glob(WEIGHTS_NAME))), None)


def load_trunk(net: StereoNet, path: Path) -> None:
    """Take the convolutions of torchvision's VGG16 with batch norm.

    Raises
    ------
    InputError
        The file is none of those.
    """
    try:
        state = torch.load(path, weights_only=True, map_location="cpu")
        prefix = "features."
        net.trunk.load_state_dict({k.removeprefix(prefix): v for k, v in state.items() if k.startswith(prefix)})
    except (OSError, RuntimeError, EOFError, AttributeError, TypeError, KeyError, pickle.UnpicklingError) as error:
        raise InputError(f"{path}: not torchvision's weights of VGG16 with batch norm ({WEIGHTS_NAME})") from error
