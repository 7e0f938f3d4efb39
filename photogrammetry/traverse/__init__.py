"""Traverses of several solutions: read from tables, compared, and used to georeference mosaics.

Stops whose telemetry cannot be true are found here too. Text and vector files come in, places in
metres and their differences go out. Figures of them are made in `products.reports`. May not import
matching, adjustment or terrain.
"""
