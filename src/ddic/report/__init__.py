"""The report of a measurement: one page that a reader can judge and repeat it by."""
