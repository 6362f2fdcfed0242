"""Theory beside the twin: what `ruffini bench mechanics` prints."""
