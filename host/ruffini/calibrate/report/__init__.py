"""`ruffini cal report`: a calibration judged on a log, as numbers and as a page."""
