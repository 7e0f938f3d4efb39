"""The endpoints of the API, one module per subject.

A route checks its parameters (`gis_server.parameters`), calls `analysis`, `rendering` or
`products` and sets the headers of the answer. It computes nothing and does not import `ogc` or
`collaboration`.
"""
