"""A robot's world in MuJoCo whose fingers feel: the pads of a board, through the core that the device runs."""

from ruffini.robot.world import World as World
