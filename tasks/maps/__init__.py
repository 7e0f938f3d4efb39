"""Maps of stops and regions: terrain, orthophotos, suitability, panoramas, models, far ground.

Enter oriented pairs of `network` and terrain models; leave rasters, vectors and models, one product
per file. May not import `mission`.
"""
