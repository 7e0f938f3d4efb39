"""What is observed and what is unknown: the network and the mathematical model of its observations.

Enters: the network of records (`network`), tie points and weights (`params`). Leaves: arrays of
observations and unknowns with their misclosures and partial derivatives (collinearity, telemetry,
control), and the records of an adjusted network. Nothing here solves equations; no other subpackage
may be imported.
"""
