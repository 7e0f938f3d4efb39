"""Visibility: viewsheds, sight lines, and the footprints of images on the map.

A terrain model and a viewpoint or a camera enter; classes of cells, stations of a line, or outlines
on the map leave. Only `dtm` may be imported of terrain.
"""
