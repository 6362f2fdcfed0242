"""Touches on a skin that gets brighter where it is pressed."""
