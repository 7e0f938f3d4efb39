"""Rover maps and orbital images or terrain models: where the one lies in the other.

A map of the ground and an orbital raster come in; a correction of the raster's georeference goes
out, or the reason why there is none. May import terrain and adjustment, and not matching.
"""
