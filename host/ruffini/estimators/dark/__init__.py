"""What a camera shows with its lamps off."""
