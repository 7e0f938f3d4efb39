"""Ties of images without a stereo partner, with each other and with the pairs of their stop.

Enter: single images resampled to square pixels (`SingleView`) and matched pairs. Leave: ties
without parallax of their own (`tying.tie_single_images`). Nothing from `cross_site` or `manual` is
imported.
"""
