"""The endpoints of the API, one module a subject: HTTP in, HTTP out.

A route checks its parameters (`gis_server.parameters`), calls `analysis`, `rendering` or
`products` and sets the headers of the answer. It computes nothing and does not import `ogc` or
`collaboration`.
"""
