"""From stereo pairs to the adjusted network: match, tie, adjust, report, and choose orientations.

Enter pairs of `images` and telemetry; leave ties, networks, quality reports, previews, and the
orientations used for mapping. `rig_table` makes no product: it lists how stereo rigs differ from
their labels. May not import `maps` or `mission`.
"""
