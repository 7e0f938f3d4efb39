"""Maintenance of a store: backups, checks, and what is removed because nothing refers to it.

Enters: a workspace. Leaves: copies, findings, and a store without what is old or broken; what is
published stays. Imports all of `products.catalogue` but `images` and `oriented_images`.
"""
