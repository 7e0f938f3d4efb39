"""How a network is adjusted: overall, stepwise, sequentially, or as a preview of manual tie points.

Enters: a network and what was adjusted before. Leaves: the adjusted network and a report. `mission`
chooses the mode for new images; `overall.adjust` is what all modes call, and `rig_calibration`,
which estimates how stereo rigs differ from their labels. May import all other subpackages of the
adjustment but `quality`, which looks at results only.
"""
