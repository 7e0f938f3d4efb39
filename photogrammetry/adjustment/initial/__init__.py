"""Where the estimate starts: poses and points near enough for Gauss-Newton.

Enters: observations, telemetry and what an earlier adjustment knows. Leaves: a state, the
observations that fit it, and findings on what images do not determine. Imports `model` alone, not
`solver`: nothing here needs normal equations of the whole network.
"""
