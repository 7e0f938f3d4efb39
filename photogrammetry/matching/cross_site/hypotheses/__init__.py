"""Hypotheses of where the later of two stops stands, found in bird's-eye views.

Enter: the bird's-eye views and dense parallax of two stops, and the search gate of telemetry.
Leave: positions and azimuths with their evidence, best first (`search.find_hypotheses`). The images
of the pairs are not matched here; `cross_site.linking` and what it calls may not be imported.
"""
