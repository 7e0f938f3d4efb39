"""Photogrammetry of rover stereo images: pure functions over arrays and frozen records."""
