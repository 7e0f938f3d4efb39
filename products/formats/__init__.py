"""File formats of products: each has one writer, and a reader for products that are read again.

Enters: arrays, records and features. Leaves: rasters, vectors, meshes, and the documents that
stages exchange (networks, matches, control). Equal input gives equal bytes. May import
`products.store` (references are resolved by it), never `products.catalogue`.
"""
