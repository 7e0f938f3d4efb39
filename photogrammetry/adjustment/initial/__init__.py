"""Initial values: poses and points close enough to the solution for Gauss-Newton.

Enters: observations, telemetry and the result of an earlier adjustment. Leaves: a state, the
observations that fit it, and findings on what images do not determine. Imports `model` alone, not
`solver`: nothing here needs normal equations of the whole network.
"""
