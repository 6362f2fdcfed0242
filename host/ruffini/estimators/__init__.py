"""What the board estimates, one package each: its part of a log, its fit, its tables and its report."""
