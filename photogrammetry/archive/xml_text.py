"""Parse XML from untrusted sources safely."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET

from solmap.photogrammetry.errors import PhotogrammetryError

MAX_CHARACTERS = 1 << 24
"""The longest known master file, of 138 sites, has 55 kB, the longest PDS4 label 120 kB."""
MAX_ELEMENTS = 1 << 20
MAX_DEPTH = 32
"""Labels have some 3,000 elements, 15 deep."""
_FORBIDDEN = re.compile(r"<!\s*(DOCTYPE|ENTITY)", re.IGNORECASE)


class _Builder(ET.TreeBuilder):
    """Builds elements without namespaces, up to the limits of known files."""

    def __init__(self, most: int) -> None:
        super().__init__()
        self._depth = self._count = 0
        self._most = most

    def start(self, tag: str, attrs: dict[str, str]) -> ET.Element:
        """Open an element."""
        self._depth += 1
        self._count += 1
        if self._depth > MAX_DEPTH:
            raise ValueError(f"elements are nested deeper than {MAX_DEPTH}")
        if self._count > self._most:
            raise ValueError(f"more than {self._most} elements")
        return super().start(tag.rpartition("}")[2], attrs)

    def end(self, tag: str) -> ET.Element:
        """Close an element."""
        self._depth -= 1
        return super().end(tag.rpartition("}")[2])


def xml_root(
    text: str,
    source: str,
    tag: str,
    what: str,
    error: type[PhotogrammetryError],
    *,
    most_elements: int = MAX_ELEMENTS,
) -> ET.Element:
    """The root element of an XML text; namespaces are removed.

    Raises:
        error: it is too long, too deep, declares entities, or is not well-formed XML under `tag`.
    """
    if len(text) > MAX_CHARACTERS:
        raise error(f"{source}: {len(text)} characters are too many for a {what} file")
    forbidden = _FORBIDDEN.search(text)
    if forbidden:
        line = text.count("\n", 0, forbidden.start()) + 1
        raise error(
            f"{source}: line {line}: <!{forbidden[1].upper()} is not allowed in {what} files"
        )
    try:
        # Entities, the one risk of this parser, were rejected above.
        root = ET.fromstring(text, ET.XMLParser(target=_Builder(most_elements)))  # noqa: S314 - see above
    except ET.ParseError as fault:
        raise error(f"{source}: not well-formed XML: {fault}") from fault
    except ValueError as fault:
        raise error(f"{source}: {fault}") from fault
    if root.tag != tag:
        raise error(f"{source}: expected <{tag}>, found <{root.tag[:40]}>")
    return root
