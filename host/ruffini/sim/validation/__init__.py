"""Theory beside the twin: what `ruffini sim validate` prints."""
