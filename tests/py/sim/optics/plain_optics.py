"""twin.toml sections without noise and without a transport that spoils anything."""

NO_NOISE = {"read_1e3": 0, "shot_1e3": 0}
PLAIN_SENSOR = {"bayer": "none", "jpeg_quality": 0, "shutter_1e3": 0}
