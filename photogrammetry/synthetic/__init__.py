"""Worlds with known truth: terrain, traverses, rendered stereo pairs and networks, from one seed.

`downlink` simulates rendered downlinks, `networks` and `mission` measurements without images. All
of photogrammetry may be imported; only the simulation, tests and benchmarks import this package.
"""
