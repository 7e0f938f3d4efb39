"""The standards of OGC on the web: landing page, features, tiles. A page of each mission."""
