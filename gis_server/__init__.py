"""The map server (Web GIS): tiles, features, images, measurements and the viewer, over HTTP.

Inputs are requests and a store of products, outputs are answers. The server changes no product:
edits and annotations go into databases of its own (`collaboration`). It imports `products`,
`photogrammetry` and `config`, never `tasks`, `flows` or Prefect.

`app` puts together `routes`, `ogc` and `collaboration`, which translate HTTP; these call `analysis`
and `rendering`, which are independent of HTTP. `services` contains their common resources.
"""
