"""Tables of the archive: vector files, PLACES tables and indexes of volumes; text in, records out.

Vector files and PLACES tables are also written. May not import `images`.
"""
