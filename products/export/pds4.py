"""PDS4 labels of rasters: layout of the values in a file, and their image.

The label is a file beside the data file; it has all that a PDS4 reader such as GDAL's needs to read
the values, and names image, time and target. Camera and frames are in the VICAR label of the file
itself. It validates against the core schema of the information model, not against a mission's own
dictionaries: solmap is not an archive, and assigns no archive identifiers.

Source: PDS4 Information Model 1.16, `Array_3D_Image`.
"""

from __future__ import annotations

from collections.abc import Iterable
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from solmap.photogrammetry.archive.missions import mission_of_host
from solmap.photogrammetry.imagery import RoverImage

_NAMESPACE = "http://pds.nasa.gov/pds4/pds/v1"
_VERSION = "1.16.0.0"


def pds4_label(
    image: RoverImage,
    *,
    name: str,
    title: str,
    offset: int,
    shape: tuple[int, int, int],
    unit: str | None,
) -> str:
    """The label of a file of little-endian floats, band after band, as XML.

    Args:
        image: The image of the values.
        name: The file.
        title: Its content.
        offset: First byte of the values.
        shape: Bands, lines and samples.
        unit: Of the values; None where they have none.
    """
    root = Element("Product_Observational", xmlns=_NAMESPACE)
    identification = _add(root, "Identification_Area")
    stem = name.rpartition(".")[0].lower()
    _add_texts(
        identification,
        (
            ("logical_identifier", f"urn:solmap:{image.stop.mission.lower()}:export:{stem}"),
            ("version_id", "1.0"),
            ("title", title),
            ("information_model_version", _VERSION),
            ("product_class", "Product_Observational"),
        ),
    )
    _observation(root, image)
    area = _add(root, "File_Area_Observational")
    _add_texts(_add(area, "File"), (("file_name", name),))
    header = _add(area, "Header")
    _add(header, "offset", "0", unit="byte")
    _add(header, "object_length", str(offset), unit="byte")
    _add(header, "parsing_standard_id", "VICAR2")
    array = _add(area, "Array_3D_Image")
    _add(array, "offset", str(offset), unit="byte")
    _add_texts(array, (("axes", "3"), ("axis_index_order", "Last Index Fastest")))
    element = _add(array, "Element_Array")
    _add(element, "data_type", "IEEE754LSBSingle")
    if unit is not None:
        _add(element, "unit", unit)
    for number, (axis, count) in enumerate(zip(("Band", "Line", "Sample"), shape, strict=True), 1):
        _add_texts(
            _add(array, "Axis_Array"),
            (("axis_name", axis), ("elements", str(count)), ("sequence_number", str(number))),
        )
    _add_texts(_add(array, "Special_Constants"), (("missing_constant", "0.0"),))
    indent(root, " ")
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + tostring(root, encoding="unicode") + "\n"


def _observation(root: Element, image: RoverImage) -> None:
    """Time, instrument and target of the image."""
    area = _add(root, "Observation_Area")
    times = _add(area, "Time_Coordinates")
    for name in ("start_date_time", "stop_date_time"):
        known = f"{image.start_time.rstrip('Z')}Z" if image.start_time else None
        place = _add(times, name, known)
        if known is None:
            place.set("nilReason", "unknown")
    investigation = _add(area, "Investigation_Area")
    _add_texts(investigation, (("name", image.stop.mission), ("type", "Mission")))
    _reference(
        investigation, f"investigation:mission.{image.stop.mission.lower()}", "investigation"
    )
    system = _add(_add(area, "Observing_System"), "Observing_System_Component")
    _add_texts(system, (("name", f"{image.instrument} {image.eye}"), ("type", "Instrument")))
    is_on_mars = mission_of_host(image.stop.mission) is not None
    target = ("Mars", "Planet") if is_on_mars else ("Unknown", "Laboratory Analog")
    _add_texts(_add(area, "Target_Identification"), zip(("name", "type"), target, strict=True))


def _reference(parent: Element, identifier: str, what: str) -> None:
    texts = (
        ("lid_reference", f"urn:nasa:pds:context:{identifier}"),
        ("reference_type", f"data_to_{what}"),
    )
    _add_texts(_add(parent, "Internal_Reference"), texts)


def _add(parent: Element, tag: str, text: str | None = None, **attributes: str) -> Element:
    element = SubElement(parent, tag, attributes)
    element.text = text
    return element


def _add_texts(parent: Element, texts: Iterable[tuple[str, str]]) -> None:
    for tag, text in texts:
        _add(parent, tag, text)
