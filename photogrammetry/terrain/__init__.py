"""From parallax to maps: DTM, orthophoto, contours, slope, aspect and hillshade."""
