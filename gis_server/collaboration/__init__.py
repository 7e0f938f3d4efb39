"""What people write: accounts and their tokens, edits of ties, notes on the map, requests for runs.

Requests with a token enter; rows of the databases beside the store leave, which the next run
reads. Each module holds the routes, bodies and logic of its subject. Products are never changed
here. It does not import `routes`, `ogc`, `analysis` or `rendering`.
"""
