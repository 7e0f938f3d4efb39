"""Products of a whole mission: its vector layers, traverse, orbital base, control; publishing.

Enter networks, layers and files of others; leave layers in the catalogue, and files for other
tools. `publish` is the only place where products become layers.
"""
