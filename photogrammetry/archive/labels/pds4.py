"""PDS4 labels: XML in, the same `Label` out as for PDS3 and VICAR.

A PDS4 product is an array in one file and an XML label beside it. The values of a camera's label
are in classes of the discipline dictionaries, which are mapped to the keywords of PDS3:

    geom:Camera_Model_Parameters        GEOMETRIC_CAMERA_MODEL      C A H V O R E T P
    geom:Coordinate_Space_Definition    ROVER_, SITE_, RSM_COORDINATE_SYSTEM by its frame's name
    geom:Derived_Geometry               SITE_ and ROVER_DERIVED_GEOMETRY_PARMS
    img_surface:, msn:, msn_surface:    INSTRUMENT_ID, IMAGE_TYPE, clock, sol, times, sequence
    Array_2D_Image, Array_3D_Image      IMAGE and ^IMAGE, with axes, data type and constants
    img:Color_Filter_Array              IMAGE/COLOR_FILTER_ARRAY_STATE: ENCODED for a Bayer frame

Namespaces are ignored: each label may choose its prefixes. Where a label describes the geometry
several times (geometry_state Telemetry, Initial), telemetry is used. The quaternion is that of
JPL's labels, named frame into reference frame, where rotation_direction is Forward, and its
conjugate where it is Reverse. The mission follows from the logical identifier.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from xml.etree.ElementTree import Element

from solmap.photogrammetry.archive.labels.label import (
    Label,
    Quantity,
    Value,
    none_if_unknown,
    number_of,
)
from solmap.photogrammetry.archive.xml_text import xml_root
from solmap.photogrammetry.errors import LabelError

HOSTS = (
    (re.compile(r"mars2020|m2020", re.IGNORECASE), "M20"),
    (re.compile(r"msl", re.IGNORECASE), "MSL"),
    (re.compile(r"mer1|opportunity", re.IGNORECASE), "MER1"),
    (re.compile(r"mer2|spirit", re.IGNORECASE), "MER2"),
)
"""Words of a logical identifier, and their spacecraft."""

FRAMES = {
    "ROVER_NAV_FRAME": "ROVER_COORDINATE_SYSTEM",
    "ROVER_FRAME": "ROVER_COORDINATE_SYSTEM",
    "SITE_FRAME": "SITE_COORDINATE_SYSTEM",
    "RSM_HEAD_FRAME": "RSM_COORDINATE_SYSTEM",
    "MAST_FRAME": "PMA_COORDINATE_SYSTEM",
}
DATA_TYPES = {
    "UnsignedByte": ("UNSIGNED_INTEGER", 8),
    "SignedByte": ("UNSIGNED_INTEGER", 8),
    "UnsignedMSB2": ("MSB_UNSIGNED_INTEGER", 16),
    "SignedMSB2": ("MSB_INTEGER", 16),
    "UnsignedLSB2": ("LSB_UNSIGNED_INTEGER", 16),
    "SignedLSB2": ("LSB_INTEGER", 16),
    "UnsignedMSB4": ("MSB_UNSIGNED_INTEGER", 32),
    "SignedMSB4": ("MSB_INTEGER", 32),
    "UnsignedLSB4": ("LSB_UNSIGNED_INTEGER", 32),
    "SignedLSB4": ("LSB_INTEGER", 32),
    "IEEE754MSBSingle": ("IEEE_REAL", 32),
    "IEEE754LSBSingle": ("PC_REAL", 32),
    "IEEE754MSBDouble": ("IEEE_REAL", 64),
    "IEEE754LSBDouble": ("PC_REAL", 64),
}
STORAGE = {
    ("LINE", "SAMPLE"): "BAND_SEQUENTIAL",
    ("BAND", "LINE", "SAMPLE"): "BAND_SEQUENTIAL",
    ("LINE", "BAND", "SAMPLE"): "LINE_INTERLEAVED",
    ("LINE", "SAMPLE", "BAND"): "SAMPLE_INTERLEAVED",
}
VECTORS = {
    "C": ("Vector_Center", ("x_position", "y_position", "z_position")),
    "A": ("Vector_Axis", ("x_unit", "y_unit", "z_unit")),
    "H": ("Vector_Horizontal", ("x_pixel", "y_pixel", "z_pixel")),
    "V": ("Vector_Vertical", ("x_pixel", "y_pixel", "z_pixel")),
    "O": ("Vector_Optical", ("x_unit", "y_unit", "z_unit")),
    "R": ("Radial_Terms", ("c0", "c1", "c2")),
    "E": ("Entrance_Terms", ("c0", "c1", "c2")),
}
SIMPLE = {
    "PRODUCT_ID": ("Identification_Area", "title"),
    "START_TIME": ("Time_Coordinates", "start_date_time"),
    "SPACECRAFT_CLOCK_START_COUNT": (None, "spacecraft_clock_start"),
    "LOCAL_TRUE_SOLAR_TIME": (None, "start_local_true_solar_time"),
    "SEQUENCE_ID": (None, "sequence_id"),
    "INSTRUMENT_ID": ("Instrument_Information", "ops_instrument_key"),
    "IMAGE_TYPE": ("Instrument_Information", "image_type"),
    "GEOMETRY_PROJECTION_TYPE": ("Geometry_Projection", "geometry_projection_type"),
}
"""Keyword of PDS3 -> class (any, if None) and attribute of PDS4; the first in the label counts."""

MAX_ELEMENTS = 30_000
"""The longest label known has some 3,000."""
Groups = dict[str, dict[str, Value]]


def parse_pds4_label(text: str, source: str) -> Label:
    """The label in an XML file.

    Raises:
        LabelError: it is not a PDS4 label of an observation, or one of its classes is broken.
    """
    root = xml_root(
        *(text, source, "Product_Observational", "PDS4 label", LabelError),
        most_elements=MAX_ELEMENTS,
    )
    groups: Groups = {"": _identification(root, source)}
    lander = _telemetry(root)
    if lander is not None:
        _add_camera(lander, groups)
        _add_frames(lander, groups, source)
        _add_directions(lander, groups)
    _add_averaging(root, groups)
    _add_array(root, groups, source)
    return Label(source, groups)


def _identification(root: Element, source: str) -> dict[str, Value]:
    lid = _text(root, "logical_identifier") or ""
    host = next((host for pattern, host in HOSTS if pattern.search(lid)), None)
    if host is None:
        raise LabelError(
            f"{source}: <logical_identifier> {lid[:80]!a} names no mission known here; expected "
            "mars2020, msl, mer1 or mer2 in it"
        )
    items: dict[str, Value] = {"INSTRUMENT_HOST_ID": host}
    for keyword, (parent, name) in SIMPLE.items():
        inside = root if parent is None else _first(root, parent)
        text = None if inside is None else _text(inside, name)
        if text is not None:
            items[keyword] = none_if_unknown(text)
    for name in ("start_sol_number", "sol_number"):
        items.setdefault("PLANET_DAY_NUMBER", number_of(_text(root, name) or ""))
        if items["PLANET_DAY_NUMBER"] is None:
            del items["PLANET_DAY_NUMBER"]
    for keyword in ("GEOMETRY_PROJECTION_TYPE", "IMAGE_TYPE"):
        word = items.get(keyword)
        if isinstance(word, str):
            items[keyword] = word.upper()
    return items


def _telemetry(root: Element) -> Element | None:
    """The description of the geometry to use."""
    found = list(root.iter("Geometry_Lander"))
    of_telemetry = [each for each in found if (_text(each, "geometry_state") or "") == "Telemetry"]
    return next(iter(of_telemetry or found), None)


def _add_camera(lander: Element, groups: Groups) -> None:
    parameters = _first(lander, "Camera_Model_Parameters")
    if parameters is None:
        return
    kind = (_text(parameters, "model_type") or "").upper()
    model = _first(parameters, f"{kind}_Model")
    items: dict[str, Value] = {"MODEL_TYPE": kind}
    groups["GEOMETRIC_CAMERA_MODEL"] = items
    frame = _first(parameters, "Coordinate_Space_Reference")
    name = None if frame is None else _frame_name(frame)
    if name:
        items["REFERENCE_COORD_SYSTEM_NAME"] = name
    if model is None:
        return
    letters = [letter for letter in kind if letter in VECTORS]
    values: list[Value] = []
    for letter in letters:
        tag, names = VECTORS[letter]
        vector = _first(model, tag)
        values.append(None if vector is None else _numbers(vector, names))
    if kind == "CAHVORE":
        letters += ["T", "P"]
        scalars = ("cahvore_model_type", "cahvore_model_parameter")
        values += [number_of(_text(model, name) or "") for name in scalars]
    items["MODEL_COMPONENT_ID"] = tuple(letters)
    items |= {f"MODEL_COMPONENT_{place}": value for place, value in enumerate(values, start=1)}


def _add_frames(lander: Element, groups: Groups, source: str) -> None:
    for space in lander.iter("Coordinate_Space_Definition"):
        present, reference = (
            _first(space, name)
            for name in ("Coordinate_Space_Present", "Coordinate_Space_Reference")
        )
        group = FRAMES.get((_frame_name(present) if present is not None else None) or "")
        if group is None or present is None or group in groups:
            continue
        index = _index(present)
        items: dict[str, Value] = {"COORDINATE_SYSTEM_INDEX": _single(index)}
        groups[group] = items
        if group == "ROVER_COORDINATE_SYSTEM":
            groups[""]["ROVER_MOTION_COUNTER"] = index
        offset = _first(space, "Vector_Origin_Offset")
        if offset is not None:
            items["ORIGIN_OFFSET_VECTOR"] = _numbers(offset, VECTORS["C"][1])
        turn = _first(space, "Quaternion_Plus_Direction")
        if turn is not None:
            items["ORIGIN_ROTATION_QUATERNION"] = _quaternion(turn, source)
        method = _text(space, "quaternion_measurement_method")
        if method:
            items["QUATERNION_MEASUREMENT_METHOD"] = method.upper()
        if reference is not None:
            _refer(reference, items)


def _refer(reference: Element, items: dict[str, Value]) -> None:
    """Name and counters of a reference frame, given in full or by reference to its name."""
    name, index = _frame_name(reference), _index(reference)
    if name is None:
        pointer = _text(reference, "local_identifier_reference") or ""
        match = re.match(r"([A-Z_]+?FRAME)((?:_\d{1,9})*)", pointer, re.ASCII)
        if match is None:
            return
        name = match[1]
        index = tuple(int(count) for count in match[2].split("_") if count)
    items["REFERENCE_COORD_SYSTEM_NAME"] = name
    if index:
        items["REFERENCE_COORD_SYSTEM_INDEX"] = _single(index)


def _single(index: tuple[Value, ...]) -> Value:
    """One counter as a number, several as a list, as in PDS3."""
    return index[0] if len(index) == 1 else index


def _quaternion(turn: Element, source: str) -> Value:
    numbers = _numbers(turn, ("qcos", "qsin1", "qsin2", "qsin3"))
    direction = _text(turn, "rotation_direction") or "Forward"
    if direction == "Reverse":
        return tuple(
            -value if place and isinstance(value, int | float) else value
            for place, value in enumerate(numbers)
        )
    if direction not in {"Forward", "Present to Reference"}:
        raise LabelError(
            f"{source}: <rotation_direction> should be Forward or Reverse, "
            f"but is {direction[:40]!a}"
        )
    return numbers


def _add_directions(lander: Element, groups: Groups) -> None:
    for derived in lander.iter("Derived_Geometry"):
        sun = _text(derived, "solar_azimuth") is not None
        group = "SITE_DERIVED_GEOMETRY_PARMS" if sun else "ROVER_DERIVED_GEOMETRY_PARMS"
        items: dict[str, Value] = {}
        for element in derived:
            name = element.tag.upper()
            number = number_of((element.text or "").strip())
            if name.endswith(("AZIMUTH", "ELEVATION")) and number is not None:
                items[name] = Quantity(number, element.get("unit", "deg"))
        groups.setdefault(group, items)


def _add_averaging(root: Element, groups: Groups) -> None:
    """Number of pixels that were actually averaged, not the commanded number."""
    for imaging in root.iter("Imaging"):
        for element in imaging:
            if element.tag == "Downsampling":
                items: dict[str, Value] = {}
                for name in ("width", "height"):
                    count = number_of(_text(element, f"{name}_pixels") or "")
                    if count is not None:
                        items[f"PIXEL_AVERAGING_{name.upper()}"] = count
                groups.setdefault("INSTRUMENT_STATE_PARMS", items)


def _colour_filters(root: Element) -> dict[str, Value]:
    """Whether a Bayer frame is still ENCODED."""
    filters = _first(root, "Color_Filter_Array")
    state = None if filters is None else _text(filters, "color_filter_array_state")
    return {} if state is None else {"COLOR_FILTER_ARRAY_STATE": state.upper()}


def _add_array(root: Element, groups: Groups, source: str) -> None:
    """Location of the pixels; of several arrays the first."""
    for name in ("Array_2D_Image", "Array_3D_Image"):
        array = _first(root, name)
        if array is not None:
            groups["IMAGE"] = _array(array, source) | _colour_filters(root)
            offset = number_of(_text(array, "offset") or "0")
            if not isinstance(offset, int) or offset < 0:
                raise LabelError(f"{source}: <offset> of {name} should be a number of bytes")
            groups[""]["^IMAGE"] = Quantity(offset + 1, "BYTES")
            return


def _array(array: Element, source: str) -> dict[str, Value]:
    axes: dict[int, tuple[str, str]] = {}
    for axis in array.iter("Axis_Array"):
        place = number_of(_text(axis, "sequence_number") or "")
        if not isinstance(place, int):
            raise LabelError(f"{source}: <sequence_number> of Axis_Array should be a whole number")
        axes[place] = ((_text(axis, "axis_name") or "").upper(), _text(axis, "elements") or "")
    named = [axes[place] for place in sorted(axes)]
    order = tuple(name for name, _ in named)
    stated = _text(array, "data_type") or ""
    sample_type, bits = DATA_TYPES.get(stated, ("", 0))
    if order not in STORAGE or not sample_type:
        raise LabelError(
            f"{source}: an array of {stated[:40]!a} with axes {', '.join(order)[:60]!a} is not "
            "supported; expected Line, Sample and perhaps Band, of integers or IEEE reals"
        )
    sizes = {name: number_of(count) for name, count in named}
    items: dict[str, Value] = {
        "LINES": sizes["LINE"],
        "LINE_SAMPLES": sizes["SAMPLE"],
        "BANDS": sizes.get("BAND", 1),
        "BAND_STORAGE_TYPE": STORAGE[order],
        "SAMPLE_TYPE": sample_type,
        "SAMPLE_BITS": bits,
    }
    for keyword in ("missing_constant", "invalid_constant"):
        constant = number_of(_text(array, keyword) or "")
        if constant is not None:
            items[keyword.upper()] = constant
    return items


def _frame_name(space: Element) -> str | None:
    return _text(space, "coordinate_space_frame_type")


def _index(space: Element) -> tuple[Value, ...]:
    """The counters of a frame, in their order."""
    return tuple(
        number_of(_text(index, "index_value_number") or "")
        for index in space.iter("Coordinate_Space_Index")
    )


def _numbers(parent: Element, names: Sequence[str]) -> tuple[Value, ...]:
    return tuple(number_of(_text(parent, name) or "") for name in names)


def _first(parent: Element, name: str) -> Element | None:
    return next(parent.iter(name), None)


def _text(parent: Element, name: str) -> str | None:
    """The text of the first descendant of a name."""
    element = _first(parent, name)
    return None if element is None else " ".join((element.text or "").split())
