"""Export: products of a store as a folder or ZIP archive for other programs.

Enters: a workspace and a selection. Leaves: files with readable names, a README, checksums, a STAC
catalogue, QGIS projects, and cameras, ties and rasters in formats of other programs. Changes
nothing in the store. Imports everything of `products`; nothing imports it but the commands.
"""
