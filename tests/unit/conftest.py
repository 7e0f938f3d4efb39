"""Runs unit tests under checks of array types and shapes; the longer tests run without them."""

from jaxtyping import install_import_hook

install_import_hook("solmap.photogrammetry", "beartype.beartype")  # before anything imports it
