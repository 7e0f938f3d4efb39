"""From images to tie points: matching within a pair, between pairs, between stops, and by hand.

Enter: images resampled to epipolar geometry (`resampling`), their camera geometry, and poses by
telemetry. Leave: `StereoMatches` and dense parallax of pairs (`stereo`), `Ties` between images
(`inter_stereo`, `cross_site`, `single`, `manual`), and the tie points of a network made of them
(`tracks`). Modules at this level are shared by the subpackages. Pure functions over arrays: no
files, no figures; nothing from `adjustment`, `terrain` or `products` is imported.
"""
