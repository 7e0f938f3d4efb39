"""Results of an inspection as lines of text."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any


def report_of(finding: Mapping[str, Any]) -> list[str]:
    """A few lines on one image or derived raster, its name first."""
    rows = _raster_rows(finding) if "raster" in finding else _image_rows(finding)
    return [finding["product"], *(f"  {name:<9}{text}" for name, text in rows if text)]


def _image_rows(finding: Mapping[str, Any]) -> list[tuple[str, str]]:
    return [
        ("taken", _acquisition(finding)),
        ("at", _at(finding)),
        ("with", _with(finding)),
        ("size", _size(finding["size"])),
        *(("note", note) for note in finding["notes"]),
        ("radiance", _radiance(finding["radiance"])),
        ("looks", _view_text(finding["pointing"], "image_centre", "the middle of the image")),
        ("", _view_text(finding["pointing"], "mast", "the mast")),
        *_camera(finding["camera"]),
        *_rover(finding["rover"]),
        ("sun", _sun(finding["sun"])),
        ("partner", _partner(finding["partner"])),
    ]


def _raster_rows(finding: Mapping[str, Any]) -> list[tuple[str, str]]:
    frame, partner = finding["frame"], finding["partner_image"]
    return [
        ("holds", finding["raster"] + (f" in the frame {frame}" if frame else "")),
        ("size", _size(finding["size"])),
        *((band["name"], _range(band)) for band in finding["bands"]),
        ("of", f"pixels of {partner}" if partner else ""),
        *_beside(finding.get("beside_store")),
    ]


def _beside(found: Mapping[str, Any] | None) -> list[tuple[str, str]]:
    """How archived values differ from those of a store."""
    if found is None:
        return []
    pixels = f"{found['pixels']} pixels, {found['share']:.0%} of those looked at"
    rows = [
        ("beside", f"the pair of {found['image_id']} in the store, {pixels}; archived less ours:")
    ]
    return [
        *rows,
        *(
            ("", f"{one['name']} {one['median']:+.4g} {one['unit']}, spread {one['spread']:.3g}")
            for one in found["differences"]
        ),
    ]


def _range(band: Mapping[str, Any]) -> str:
    if band["range"] is None:
        return "no value"
    low, high = band["range"]
    return f"{low:.6g} to {high:.6g} {band['unit'] or ''}".rstrip()


def _radiance(scale: Mapping[str, float] | None) -> str:
    if scale is None:
        return ""
    return f"{scale['factor']:.6g} x pixel + {scale['offset']:.6g} W m^-2 sr^-1 nm^-1"


def _acquisition(finding: Mapping[str, Any]) -> str:
    parts = [f"{finding['mission']} sol {finding['sol']}"]
    if finding["local_solar_time"]:
        parts.append(f"{finding['local_solar_time']} local solar time")
    if finding["start_time"]:
        parts.append(f"{finding['start_time'].removesuffix('Z')} UTC")
    return ", ".join(parts)


def _at(finding: Mapping[str, Any]) -> str:
    counter = ", ".join(map(str, finding["motion_counter"]))
    return f"site {finding['site']}, drive {finding['drive']} (motion counter {counter})"


def _with(finding: Mapping[str, Any]) -> str:
    wheel = "" if finding["filter"] is None else f", filter {finding['filter']}"
    kind = "linearised" if finding["is_linearised"] else "raw geometry"
    return (
        f"{finding['instrument']} {finding['eye']} eye{wheel}; {finding['product_type']}, {kind}; "
        f"sequence {finding['sequence'] or 'unknown'}"
    )


def _size(size: Mapping[str, Any]) -> str:
    masked = size["masked_share"]
    share = "" if masked is None else f", {masked:.2%} masked"
    return f"{size['samples']} x {size['lines']} pixels{share}"


def _view_text(pointing: Mapping[str, Any], which: str, what: str) -> str:
    if which not in pointing:
        return ""
    in_site, in_rover = pointing[which]["in_site_deg"], pointing[which]["in_rover_deg"]
    return (
        f"{what} at azimuth {in_site[0]:.2f}, elevation {in_site[1]:.2f} deg in the site frame; "
        f"{in_rover[0]:.2f}, {in_rover[1]:.2f} deg in the rover frame"
    )


def _camera(camera: Mapping[str, Any]) -> list[tuple[str, str]]:
    return [
        (
            "camera",
            f"{camera['model']}, focal length {_numbers(camera['focal_px'], 1)} px, "
            f"principal point {_numbers(camera['principal_point_px'], 1)} px, "
            f"field of view {_numbers(camera['field_of_view_deg'], 2, ' x ')} deg",
        ),
        (
            "",
            f"centre at {_numbers(camera['centre_in_rover_m'], 4)} m in the rover frame; "
            f"omega, phi, kappa {_numbers(camera['omega_phi_kappa_deg'], 3)} deg",
        ),
    ]


def _rover(rover: Mapping[str, Any]) -> list[tuple[str, str]]:
    mast = rover["mast_in_rover_m"]
    return [
        ("rover", f"at {_numbers(rover['in_site_m'], 3)} m north, east, down of the site's origin"),
        (
            "",
            f"roll, pitch, yaw {_numbers(rover['roll_pitch_yaw_deg'], 3)} deg, "
            f"measured by {rover['attitude_measured_by']}",
        ),
        ("mast", f"at {_numbers(mast, 4)} m in the rover frame" if mast else ""),
    ]


def _sun(sun: Mapping[str, Any] | None) -> str:
    if sun is None:
        return ""
    azimuth, elevation = sun["in_site_deg"]
    return f"at azimuth {azimuth:.2f}, elevation {elevation:.2f} deg in the site frame"


def _partner(partner: Mapping[str, Any]) -> str:
    return partner["product"] or f"none lies beside it: {partner['why_none']}"


def _numbers(values: Iterable[float], digits: int, between: str = ", ") -> str:
    return between.join(f"{value:.{digits}f}" for value in values)
