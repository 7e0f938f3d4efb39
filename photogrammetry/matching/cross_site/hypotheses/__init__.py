"""Hypotheses of where the later of two stops stands, found in bird's-eye views.

Enter: the bird's-eye views of two stops, and the search gates of telemetry, narrowest first.
Leave: positions and azimuths, best first, and their gate (`search.find_hypotheses`). The images of
the pairs are not matched here; `cross_site.linking` and what it calls may not be imported.
"""
