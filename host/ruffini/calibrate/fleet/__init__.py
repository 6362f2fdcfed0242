"""`ruffini cal fleet`: many units fitted alike."""
