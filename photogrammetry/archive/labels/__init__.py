"""Labels: text or bytes of any format in, one `Label` out.

PDS3 (ODL), VICAR and PDS4 (XML), attached to the data or detached. May not import `images` and
`tables`.
"""
