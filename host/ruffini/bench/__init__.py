"""Published benchmarks: our methods and the papers' on the same simulated truth."""
