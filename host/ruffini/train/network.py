"""The displacement network: a small U-Net from two pictures to the nodes.

    input    (n, 6, h, w) grey levels 0 to 255: B G R of the frame, then B G R of the untouched pad
    output   (n, 3, n_y, n_x) micrometres: u_x, u_y, u_z of the board's observed nodes

Strides of 2 go down five times and up three times; the features are then read, bilinearly, where a pinhole sees each
node at rest, and a head turns them into displacement. Scales are inside: an exported file needs nothing beside it.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import torch
from torch import nn
from torch.nn import functional

from ruffini.boards import Board

Array = npt.NDArray[np.float64]

GREY_SCALE = 64.0  # grey levels that become 1
CHANGE_SCALE = 16.0
WIDTHS = (16, 32, 48, 72, 96)  # channels at 1/2, 1/4, 1/8, 1/16 of the picture and of the lowest level
N_FEATURES = 48
HEAD = 48
FEATURE_STEP = 4  # pixels between the features that the nodes read


def _block(n_in: int, n_out: int, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(n_in, n_out, 3, stride=stride, padding=1, bias=False), nn.BatchNorm2d(n_out), nn.ReLU()
    )


def node_weights(board: Board, shape: tuple[int, int], factor: int) -> tuple[Array, Array]:
    """Bilinear weights from the features to the nodes along each axis, (n_y, h) and (w, n_x).

    Feature i is centred on pixel FEATURE_STEP i of the picture that was shrunk by `factor`.
    """
    camera, grid, pad = board.camera, board.grid, board.pad
    rows, columns = board.observed
    out = []
    for n, chosen, size_um, center_mpx, n_features in (
        (grid.n_y, rows, pad.size_y_um, camera.center_y_mpx, shape[0]),
        (grid.n_x, columns, pad.size_x_um, camera.center_x_mpx, shape[1]),
    ):
        place_um = (np.linspace(-0.5, 0.5, n) * size_um)[chosen]
        place_px = center_mpx * 1e-3 + camera.focal_mpx * 1e-3 * place_um / camera.standoff_um
        at = np.clip(((place_px + 0.5) / factor - 0.5) / FEATURE_STEP, 0, n_features - 1)
        out.append(np.maximum(1 - np.abs(at[:, None] - np.arange(n_features)), 0))
    return out[0], out[1].T


class DisplacementNet(nn.Module):
    """See above. `scale_um` (3,): standard deviation of what it is trained on, along x, y, z."""

    def __init__(self, board: Board, size: tuple[int, int], factor: int, scale_um: Array) -> None:
        super().__init__()
        a, b, c, d, e = WIDTHS
        self.stem = nn.Sequential(_block(9, a, 2), _block(a, a))
        self.down = nn.ModuleList(
            nn.Sequential(_block(n_in, n_out, 2), _block(n_out, n_out))
            for n_in, n_out in ((a, b), (b, c), (c, d), (d, e))
        )
        self.up = nn.ModuleList([_block(e + d, d), _block(d + c, c), _block(c + b, N_FEATURES)])
        self.head = nn.Sequential(
            nn.Conv2d(N_FEATURES, HEAD, 3, padding=1),
            nn.ReLU(),
            nn.Conv2d(HEAD, HEAD, 1),
            nn.ReLU(),
            nn.Conv2d(HEAD, 3, 1),
        )
        features = [-(-n // FEATURE_STEP) for n in size]
        to_rows, to_columns = node_weights(board, (features[0], features[1]), factor)
        self.register_buffer("to_rows", torch.tensor(to_rows, dtype=torch.float32))
        self.register_buffer("to_columns", torch.tensor(to_columns, dtype=torch.float32))
        self.register_buffer("scale_um", torch.tensor(scale_um, dtype=torch.float32).reshape(1, 3, 1, 1))

    def forward(self, pictures: torch.Tensor) -> torch.Tensor:
        frame, rest = pictures[:, :3], pictures[:, 3:]
        x = torch.cat([(frame - 128) / GREY_SCALE, (rest - 128) / GREY_SCALE, (frame - rest) / CHANGE_SCALE], dim=1)
        levels = [self.stem(x)]
        for down in self.down:
            levels.append(down(levels[-1]))
        x = levels.pop()
        for up in self.up:
            skip = levels.pop()
            x = functional.interpolate(x, size=[int(n) for n in skip.shape[-2:]], mode="nearest")
            x = up(torch.cat([x, skip], dim=1))
        x = torch.matmul(torch.matmul(self.to_rows, x), self.to_columns)
        return self.head(x) * self.scale_um
