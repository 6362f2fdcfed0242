"""A camera or video of this computer as a sensor: ruffinid on a line of its own, with a store for each unit."""
