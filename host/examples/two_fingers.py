"""Two sensors on a common clock: the force that squeezes an object and the one that it weighs.

python two_fingers.py LEFT_PORT RIGHT_PORT [GROUPS]
"""

import itertools
import sys

import ruffini

LEFT, RIGHT = sys.argv[1:3]
N_GROUPS = int(sys.argv[3]) if len(sys.argv) > 3 else None

with ruffini.connect(LEFT, depth=0) as left, ruffini.connect(RIGHT, depth=0) as right:
    for group in itertools.islice(ruffini.synchronized([left, right], tolerance_s=0.008), N_GROUPS):
        one, two = (frame.wrench.force for frame in group)  # NaN where not valid
        squeeze = -(one[2] + two[2]) / 2
        print(f"squeezed by {squeeze:.3f} N, sheared by {one[:2].round(3)} and {two[:2].round(3)} N, "
              f"{1e3 * group.spread_s:.1f} +- {1e3 * group.error_s:.1f} ms apart")  # fmt: skip
