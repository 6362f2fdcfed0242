"""Networks that are trained on the digital twin: float peers of what the board computes. README.md says more."""
