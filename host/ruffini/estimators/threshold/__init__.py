"""What counts as a touch on one unit."""
