"""The weighted least-squares estimate of all unknowns, and which observations are blunders.

Enters: observations, telemetry, control and a start. Leaves: the solution with its normal
equations, residuals and covariances (`estimate.Outcome`), and from it records (`results`) and the
marginal of stops that are no longer estimated (`marginalisation`). From the bottom up: `layout`,
`block_matrix`, `elimination`, `problem`, `normal_equations`, `gauss_newton`, `residuals`,
`blunders`, `estimate`. Imports `model` alone.
"""
