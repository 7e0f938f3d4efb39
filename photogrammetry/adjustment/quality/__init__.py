"""Quality of an adjusted network, as figures and as text.

Enters: an adjusted network, telemetry, and the camera of every pair. Leaves: the record `Quality`
for reports (`network_quality`), the weak parts of the network (`weaknesses`), and how far ground
moves when poses change (`movement`). Imports `model` alone; JSON and figures are made in
`products`.
"""
