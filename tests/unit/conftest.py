"""Runs unit tests under checks of array types and shapes; the longer tests run without them."""

from tests.support import array_checks

array_checks.install()  # before anything imports what it checks
