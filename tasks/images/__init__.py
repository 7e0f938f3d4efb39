"""The files of a downlink become products: images with their partners, telemetry, manual ties.

Enter folders of files, leave image products, entries of the catalogue, the stops as telemetry has
them, and pairs as records that later stages read by. Imported by `network`, `maps` and `mission`.
"""
