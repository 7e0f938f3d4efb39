"""Parameters of the pipeline, and where things are: from TOML files and the environment.

Leave frozen records that flows hand on to tasks; `gis_server` reads the settings. A wrong key is an
error that names itself. Imports `products` and `photogrammetry`, whose parameter records it
mirrors, and neither `tasks` nor Prefect.
"""
