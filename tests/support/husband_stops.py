"""The stops of `rendered_husband`, see `rendered_stops`."""

from tests.support.rendered_stops import HUSBAND, matched_pairs
from tests.support.rendered_stops import rendered_stop as husband_stop

__all__ = ["HUSBAND", "husband_stop", "matched_pairs"]
