"""Documents that stages exchange, and files of rows written by people.

Enters: networks, control, matches and ties as records and arrays. Leaves: JSON and NumPy archives,
read back bit for bit; from people's CSV and GeoJSON files, checked rows with messages that name the
fault. Imports no other format.
"""
