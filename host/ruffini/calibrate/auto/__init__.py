"""`ruffini cal auto`: collect, fit, report, flash, and judge where nothing was pressed before."""
