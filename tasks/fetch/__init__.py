"""Fetch: stereo pairs of a range of sols from the archive, by its index."""
