"""Maintenance of a store: backups, checks, and removal of unreferenced products.

Enters: a workspace. Leaves: copies, findings, and a store without old or broken files; published
products are kept. Imports all of `products.catalogue` but `images` and `oriented_images`.
"""
