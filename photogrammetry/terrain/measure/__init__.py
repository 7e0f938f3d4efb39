"""Measurements with their standard deviations: points, lines, areas, planes.

Terrain models, images with covariances of their poses, and points picked by a person enter; points
with covariances, lengths, volumes, strike and dip leave. Of terrain `dtm`, `relief` and
`visibility` may be imported.
"""
