"""Export: products of a store as a folder or ZIP archive that other programs open.

Enters: a workspace and what is asked for. Leaves: files with names that people can read, a README,
checksums, a STAC catalogue, QGIS projects, and cameras, ties and rasters in formats of others.
Changes nothing in the store. Imports everything of `products`; nothing imports it but the commands.
"""
