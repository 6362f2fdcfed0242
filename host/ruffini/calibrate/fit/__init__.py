"""`ruffini cal fit`: the table of stages, the job that they share, and the run."""
