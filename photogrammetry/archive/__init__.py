"""Files of the image archives (PDS3, PDS4, VICAR, public raw images): bytes in, records out.

`labels` reads labels of every kind into one `Label`, `images` makes images and derived rasters from
labels and data, `tables` reads and writes poses of sites and stops and volume indexes. Modules at
this level handle the names of files and missions and the search for stereo partners. Nothing here
opens a file, and nothing imports matching, adjustment or terrain.
"""
