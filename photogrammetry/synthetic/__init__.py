"""Worlds with known truth: terrain, traverses, rendered stereo pairs and networks, from one seed.

`downlink` is the entrance for rendered downlinks, `networks` and `mission` for measurements without
images. Whatever of the science is needed may be imported; only the simulation, tests and benchmarks
import this package.
"""
