"""Least-squares adjustment of the image network."""
