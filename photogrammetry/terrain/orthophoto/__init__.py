"""Images of the ground rendered from the views of a stop: orthophotos and panoramas.

Views, images and a terrain model enter; brightness leaves block by block, with the source of every
cell. `view_sampling` projects cells into images and `brightness` balances the views, for both.
Only `dtm` may be imported of terrain.
"""
