"""Simulated bodies that are no plain slab: a tray on springs, a skin round a tube, a dome."""
