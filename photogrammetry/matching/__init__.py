"""From images to matches and tie points: interest points, stereo, inter-stereo and cross-site."""
