"""Manual tie points: edit requests applied to the automatic ties.

Enter: requests that add, veto or move ties, with the cameras and dense parallax of their images.
Leave: the edited ties with a note on every request that changed nothing (`editing`), and points
measured near a picked place (`picking`). Nothing from `cross_site` or `single` is imported.
"""
