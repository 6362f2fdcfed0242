"""A ruffini force sensor as a camera of LeRobot: `--robot.cameras="{pad: {type: ruffini}}"`."""

from lerobot_camera_ruffini.config_ruffini import RuffiniCameraConfig
from lerobot_camera_ruffini.ruffini_camera import RuffiniCamera, Touch

__all__ = ["RuffiniCamera", "RuffiniCameraConfig", "Touch"]
