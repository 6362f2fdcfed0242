"""A robot's world in MuJoCo whose fingers feel: the pads of a board, through the core that the device runs."""

from ruffini.robot.gripper import Gripper as Gripper
from ruffini.robot.gripper import Thing as Thing
from ruffini.robot.world import World as World
