"""Products of a whole mission: its vector layers, traverse, orbital base, control; publishing.

Enter networks, layers and external files; leave layers in the catalogue, and files for other tools.
Only `publish` turns products into layers.
"""
