"""Logs of touches as the fits need them, whatever file they came in."""
