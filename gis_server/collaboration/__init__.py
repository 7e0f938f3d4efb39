"""Input of people: accounts and tokens, edits of ties, notes on the map, requests for runs.

Inputs are requests with a token, outputs are rows of databases beside the store, which the next
run reads. Each module holds the routes, bodies and logic of its subject. Products are never changed
here. It does not import `routes`, `ogc`, `analysis` or `rendering`.
"""
