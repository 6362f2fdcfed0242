"""The main job: the whole path from frames to newtons, shown and judged."""
