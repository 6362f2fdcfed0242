"""Colour change or brightness to slope and depth, fitted on ball presses."""
