"""Tie points between two stops, image-matched and surface-matched.

Enter: two `MatchedStop`s with poses by telemetry. Leaves: a `SiteLink` (`linking.tie_cross_site`):
the decision with its figures, image-matched and surface-matched ties, and the relative pose.
Hypotheses of that pose come from `hypotheses`. Nothing from `single` or `manual` is imported.
"""
