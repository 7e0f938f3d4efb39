"""Where a rover may stand and drive: hazards and reachability.

A terrain model enters; hazard classes, and the shortest drives from a point, leave. Only `dtm` may
be imported of terrain.
"""
