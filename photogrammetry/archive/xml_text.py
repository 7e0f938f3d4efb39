"""XML that may come from anywhere, parsed without its dangers."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET

from solmap.photogrammetry.errors import PhotogrammetryError

MAX_CHARACTERS = 1 << 24
"""The longest master file known, of 138 sites, has 55 kB, the longest PDS4 label 120 kB."""
_FORBIDDEN = re.compile(r"<!\s*(DOCTYPE|ENTITY)", re.IGNORECASE)


def xml_root(
    text: str, source: str, tag: str, what: str, error: type[PhotogrammetryError]
) -> ET.Element:
    """The root element of an XML text.

    Raises:
        error: it is too long, declares entities, or is not well-formed XML under `tag`.
    """
    if len(text) > MAX_CHARACTERS:
        raise error(f"{source}: {len(text)} characters are too many for a {what} file")
    forbidden = _FORBIDDEN.search(text)
    if forbidden:
        line = text.count("\n", 0, forbidden.start()) + 1
        raise error(
            f"{source}: line {line}: <!{forbidden[1].upper()} is refused; {what} files have none"
        )
    try:
        # Entities, the one danger of this parser, were refused above.
        root = ET.fromstring(text)  # noqa: S314 - see the line before
    except (ET.ParseError, ValueError) as fault:
        raise error(f"{source}: not well-formed XML: {fault}") from fault
    if local_name(root) != tag:
        raise error(f"{source}: expected <{tag}>, found <{local_name(root)[:40]}>")
    return root


def local_name(element: ET.Element) -> str:
    """The tag without its namespace."""
    return element.tag.rpartition("}")[2]
