"""Bundle adjustment of the image network of a traverse.

A network of stops, stereo pairs, tie points, telemetry and control enters; adjusted poses, points
and their covariances leave, with a report. Begin at `modes.overall.adjust`: it finds initial values
(`initial.values`), estimates (`solver.estimate`, `gauss_newton`, `normal_equations`) and makes the
records (`solver.results`). Each package may import those to its right:

    modes  ->  quality | initial | solver  ->  model
"""
