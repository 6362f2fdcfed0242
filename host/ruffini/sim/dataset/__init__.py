"""Datasets of simulated presses: HDF5 shards that any number of processes make and one writes."""
