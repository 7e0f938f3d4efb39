"""One module per stage: read, compute, keep."""
