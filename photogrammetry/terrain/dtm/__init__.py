"""Terrain models of stops and regions.

Views enter (`records.TerrainView`), digital terrain models leave (`records.Dtm`), each cell with an
elevation, its standard deviation and a class. `grid` is the map's lattice, `ground` what one view
shows, `stop_dtm` and `region_dtm` build the models, `resampling` reads them. The other packages of
terrain may not be imported.
"""
