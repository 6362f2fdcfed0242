"""Networks that are trained on the digital twin: float peers of what the board computes. README.md says more."""

from importlib.util import find_spec

from ruffini.extras import missing


def need_torch(work: str) -> None:
    """To be asked before anything is pressed or read for minutes. Raises InputError where PyTorch is not installed."""
    if find_spec("torch") is None:
        raise missing(work, "train")
