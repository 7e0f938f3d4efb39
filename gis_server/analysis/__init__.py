"""Measuring on the maps and in the images.

Inputs are validated requests (`bodies`) and published layers or networks, outputs are response
records. Every module contains the requests, responses and computation of its subject; the science
itself is in `photogrammetry`. Independent of HTTP; does not import `routes`.
"""
