"""Products: files, recipes, storage and published versions.

Enters: arrays and records of `photogrammetry`, and recipes of `tasks`. Leaves: files in the store,
layers in the catalogue, documents and pages. Each subpackage imports only those to its right:

    export -> features | reports -> catalogue -> formats -> store -> model | crs -> errors

May import `photogrammetry`, and nothing of `tasks`, `flows`, `config` or `gis_server`.
"""
