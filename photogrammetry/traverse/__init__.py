"""Traverses of several solutions: read from tables, compared, and used to georeference mosaics.

It also finds stops with impossible telemetry. Text and vector files enter, positions in metres and
their differences leave. Figures are made in `products.reports`. May not import matching, adjustment
or terrain.
"""
