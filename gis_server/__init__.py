"""The map server (Web GIS): tiles, features, images, measurements and the viewer, over HTTP.

Requests and a store of products enter; answers leave. The server changes no product: what people
write goes into databases of its own (`collaboration`). It imports `products`, `photogrammetry` and
`config`, never `tasks`, `flows` or Prefect.

`app` puts together `routes`, `ogc` and `collaboration`, which translate HTTP; these call `analysis`
and `rendering`, which are independent of HTTP. `services` has their common resources.
"""
