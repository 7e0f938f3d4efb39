"""Measuring on the maps and in the images.

Validated requests (`bodies`) and published layers or networks enter; response records leave. Every
module has the requests, the responses and the computation of its subject; the science itself is in
`photogrammetry`. Independent of HTTP; does not import `routes`.
"""
