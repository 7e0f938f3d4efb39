"""The catalogue: databases of published layers, and access to products through it.

Enters: layers, images and outcomes to publish; runs, edits, requests and tokens to record. Leaves:
the latest version of every layer, images with their labels and orientations, events, and the
unreferenced products. `Workspace` is a store and its catalogue opened together; `maintenance` backs
up, checks and prunes both. May import `products.formats` and `products.store`, not `features` or
`reports`.
"""
