"""Manual tie points: edit requests of people, applied to the automatic ties.

Enter: rows of files in which a person adds, vetoes or moves ties (`requests`), the cameras and
dense parallax of the images named. Leave: the edited ties with a note on every row that changed
nothing (`editing`), and points measured near a picked place (`picking`). Nothing from `cross_site`
or `single` is imported.
"""
