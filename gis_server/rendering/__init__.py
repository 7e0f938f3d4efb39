"""Tile address and layer in, bytes out; knows nothing of HTTP."""
