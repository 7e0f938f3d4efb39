"""Bundle adjustment of the image network of a traverse."""
