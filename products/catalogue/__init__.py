"""The catalogue: databases of what is published, and what is read by way of it.

Enters: layers, images and outcomes to publish; runs, edits, requests and tokens to record. Leaves:
the latest version of every layer, images with their labels and orientations, events, and what may
be pruned. `Workspace` is a store and its catalogue opened together; `maintenance` keeps both sound.
May import `products.formats` and `products.store`, not `features` or `reports`.
"""
