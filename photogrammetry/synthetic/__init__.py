"""Worlds with known truth: terrain, traverse, cameras, images and their PDS3 files."""
