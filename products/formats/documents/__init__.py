"""Documents that stages hand to each other, and files of rows that people write.

Enters: networks, control, matches and ties as records and arrays. Leaves: JSON and NumPy archives,
read back bit for bit; of people's CSV and GeoJSON files, checked rows that name what is wrong.
Imports no other format.
"""
