"""Reports: figures, pages and quick-looks for people, and STAC for programs that search.

Enters: results of the science, and what store and catalogue know. Leaves: SVG, PNG, HTML and JSON;
nothing is computed anew. May import `catalogue` and `formats`, not `features`.
"""
