"""Terrain models of stops and regions.

Views enter (`records.TerrainView`), digital terrain models leave (`records.Dtm`), each cell with an
elevation, its standard deviation and a class. `grid` is the map's lattice, `ground` the ground
points of one view, `stop_dtm` and `region_dtm` build the models, `resampling` interpolates them.
The other packages of terrain may not be imported.
"""
