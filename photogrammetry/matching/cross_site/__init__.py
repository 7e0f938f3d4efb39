"""Tie points between two stops, from image patches and from the shape of the ground.

Enter: two `MatchedStop`s, placed by telemetry. Leaves: a `SiteLink` (`linking.tie_cross_site`): the
verdict with its figures, image-matched and surface-matched ties, and the relative pose. Hypotheses
of that pose come from `hypotheses`. Nothing from `single` or `manual` is imported.
"""
