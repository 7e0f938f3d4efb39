"""Terrain: from oriented, matched stereo pairs to maps, models and measurements of the ground.

Views (a pose, a parallax map, an image) enter; terrain models, orthophotos, panoramas, relief,
meshes and measurements leave, as arrays and records. `dtm` is the base; `orthophoto`, `relief`,
`visibility`, `traversability`, `insolation`, `mesh` and `measure` use its models. Nothing here
reads or writes files; `matching` and `cameras` may be imported, `adjustment` may not.
"""
