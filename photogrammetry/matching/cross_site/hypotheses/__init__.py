"""Hypotheses of the later stop's pose, found in bird's-eye views.

Enter: the bird's-eye views of two stops, and the search gates of telemetry, narrowest first. Leave:
positions and azimuths, best first, and their gate (`search.find_hypotheses`). Images of the pairs
are not matched here; `cross_site.linking` and the modules that it calls may not be imported.
"""
