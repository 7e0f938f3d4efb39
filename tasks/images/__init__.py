"""Ingest the files of a downlink: images with their partners, telemetry, manual ties.

Enter folders of files, leave image products, entries of the catalogue, the stops by telemetry, and
records of pairs for later stages. Imported by `network`, `maps` and `mission`.
"""
