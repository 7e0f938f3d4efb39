"""Fetch stereo pairs of a range of sols from the archive, by the index of its volume.

Enter addresses and a selection, leave files in a folder, each complete or absent. Imports nothing
of the other tasks but `stage`.
"""
