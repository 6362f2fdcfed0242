"""The calibration bench: reference force sensors, motion stages, and the collection of touches with them."""
