"""The calibration rig: what measures the true force (references), what presses (stages), and how they meet."""
