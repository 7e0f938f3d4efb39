"""Reports: figures, pages and previews for people, and STAC for programs.

Enters: results of the science, and data of store and catalogue. Leaves: SVG, PNG, HTML and JSON;
nothing is computed again. May import `catalogue` and `formats`, not `features`.
"""
