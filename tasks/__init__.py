"""The stages as tasks: each reads products, calls the science, and stores the result.

Inputs and outputs are references of a few bytes (`ProductRef`); arrays stay in the store. Only
`flows` imports from here; tasks import `products` and `photogrammetry`, neither `config` nor
`gis_server`. Packages in the order of the pipeline: `fetch`, `images`, `network`, `maps`,
`mission`, each importing only those before it.
"""
