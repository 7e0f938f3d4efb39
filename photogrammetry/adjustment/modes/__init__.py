"""How a network is adjusted: overall, stepwise, sequentially, or as a preview of manual tie points.

Enters: a network and what was adjusted before. Leaves: the adjusted network and a report. `mission`
chooses the mode for new images; `overall.adjust` is what all modes call. May import all other
subpackages of the adjustment but `quality`, which looks at results only.
"""
