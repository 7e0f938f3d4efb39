"""How a network is adjusted: overall, stepwise, sequentially, or as a preview of manual tie points.

Enters: a network and the previous adjustment. Leaves: the adjusted network and a report. `mission`
chooses the mode for new images. All modes call `overall.adjust`, and so does `rig_calibration`,
which estimates how stereo rigs differ from their labels. May import all other subpackages of the
adjustment but `quality`, which reads results only.
"""
