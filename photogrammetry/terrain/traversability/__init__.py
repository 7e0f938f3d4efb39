"""Where a rover may stand and drive.

A terrain model enters; hazard classes, and the shortest drives from a place, leave. Only `dtm` may
be imported of terrain.
"""
