"""Parameters of the pipeline, and locations: from TOML files and the environment.

Leave frozen records that flows pass to tasks; `gis_server` reads the settings. The error of a wrong
key names the key. Imports `products` and `photogrammetry`, whose parameter records it mirrors, and
neither `tasks` nor Prefect.
"""
