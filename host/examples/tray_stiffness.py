"""A straight line from three targets' motion to force, as the F-TOUCH paper fits it, on a log of `ruffini cal convert`.

ruffini cal convert host/examples/tray.csv --columns host/examples/tray.toml --out tray.h5
python host/examples/tray_stiffness.py tray.h5
"""

import sys
from pathlib import Path

import numpy as np

from ruffini.rig.log_file import read_log

log = read_log(Path(sys.argv[1]))
features = [t.arrays["marker_displacement"].reshape(len(t.arrays["marker_s"]), -1) for t in log.touches]
forces = [t.arrays["reference_wrench"][:, :3] for t in log.touches]
fitted, *_ = np.linalg.lstsq(np.vstack(features), np.vstack(forces), rcond=None)
stiffness = fitted.T.reshape(3, -1, 3).sum(axis=1)  # the targets move alike here: only their sum is known
print(f"{len(log.touches)} touches; N a metre along x and y, N a unit of relative area:")
for axis, row in zip("xyz", stiffness, strict=True):
    print(f"  F{axis}", *(f"{value:8.0f}" for value in row))
