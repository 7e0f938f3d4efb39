"""Camera models of JPL's rover cameras, and the epipolar (linearised) geometry of a stereo pair."""
