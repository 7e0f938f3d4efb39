"""Measuring on the maps and in the images.

Checked questions (`bodies`) and published layers or networks enter; answers leave, as the records
that are sent. Every module has the questions, the answers and the computation of its subject; the
science itself is in `photogrammetry`. It knows nothing of HTTP and does not import `routes`.
"""
