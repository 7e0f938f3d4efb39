"""Registration of rover maps with orbital images or terrain models.

Enter: a map of the ground and an orbital raster. Leaves: a correction of the raster's georeference,
or the reason why there is none. May import terrain and adjustment, and not matching.
"""
