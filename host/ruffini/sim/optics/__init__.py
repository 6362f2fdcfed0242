"""What the camera sees of a deformed surface, put together from twin.toml (`optics.renderer`)."""
