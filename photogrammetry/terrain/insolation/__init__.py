"""The energy of the sun on the ground, and the ground on which a rover may spend the winter.

A terrain model, a latitude and seasons enter; maps of energy per sol and outlines of winter havens
leave. Of terrain `dtm` and `relief` may be imported.
"""
