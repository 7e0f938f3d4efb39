"""Labels: text or bytes in, one `Label` out, whatever it was written in.

PDS3 (ODL), VICAR and PDS4 (XML), attached to the data or in a file of its own. May not import
`images` and `tables`.
"""
