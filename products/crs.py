"""The local map of a landing site, and its position on Mars.

The map is the plane tangent to a sphere of radius R at the landing point (longitude l0, latitude
p0): the orthographic projection

    east  = R cos p sin(l - l0)
    north = R (cos p0 sin p - sin p0 cos p cos(l - l0))

projects a point of the sphere perpendicularly to that plane (Snyder 1987, section 20). East is y
and north is x of the LSL, exactly, for points on the sphere; no other projection has that property,
and PROJ and proj4js agree on it to a nanometre when R is part of its definition (proj4js ignores
`+k_0`, so the local radius cannot be introduced by a scale factor).

R is chosen once, with the landing point, and written into the CRS. A landing point on the IAU
sphere (3396190 m) uses IAU_2015:49900 itself as its base, so that every tool recognises Mars. At
Gusev the ground lies near 3393.0 km from the centre: on the IAU sphere, longitude and latitude of a
point 7 km from the lander would be 6.6 m off. A landing point with its own radius therefore uses a
sphere of that radius, named after the landing point. Planetocentric longitude and latitude are
directions from the centre of Mars and the same numbers on either sphere.

Height is not part of this CRS: it is metres above the tangent plane at the landing point, which
departs from the sphere by d²/2R (0.15 m at 1 km, 3.7 m at 5 km). A point 100 m above the plane is
displaced by 15 cm at 7 km; rasters and vectors share that shift, so they stay aligned.

The map of sites not tied to the lander has no position on Mars, and that of an own stereo rig is on
no known body: its CRS is an engineering CRS in metres east and north of its origin, named
accordingly, and its points have no longitude and latitude (NaN).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, lru_cache
from typing import TYPE_CHECKING

from solmap.products.errors import ProductError

if TYPE_CHECKING:
    from pyproj import CRS, Transformer

    from solmap.photogrammetry.arrays import PerPoint

IAU_RADIUS_M = 3_396_190.0
MARS = "IAU_2015:49900"
"""Mars as a sphere: planetocentric latitude, longitude positive to the east."""
MARS_URN = "urn:ogc:def:crs:IAU:2015:49900"
_POLAR_RADIUS_M, _HIGHEST_RADIUS_M = 3_366_000.0, 3_418_000.0  # floor of the north cap, Olympus


_ORIGIN = "origin: "


@dataclass(frozen=True, slots=True)
class LandingPoint:
    """The origin of a mission's map: its position on Mars, and the source of it."""

    name: str
    longitude: float
    """Degrees, positive to the east."""
    latitude: float
    """Degrees, planetocentric."""
    radius_m: float
    """Distance of the ground from the centre of Mars, metres; 0 for an unknown body."""
    source: str
    sigma_m: float = 0.0
    """Standard deviation of its position on Mars, of each coordinate."""
    origin: str = ""
    """Origin of a map that is not tied to the lander: `site 137`. Longitude, latitude and radius
    are then only those of the mission, for the height of the Sun."""

    def __post_init__(self) -> None:
        if not (-180.0 <= self.longitude <= 360.0 and -90.0 <= self.latitude <= 90.0):  # noqa: PLR2004
            raise ProductError(
                f"the landing point {self.name} at longitude {self.longitude}, latitude "
                f"{self.latitude} is not on a globe; degrees east and planetocentric are expected"
            )
        if self.is_on_mars and not _POLAR_RADIUS_M < self.radius_m < _HIGHEST_RADIUS_M:
            raise ProductError(
                f"the landing point {self.name} is {self.radius_m} m from the centre of Mars, "
                f"where there is no ground; metres near {IAU_RADIUS_M} are expected"
            )
        if not self.name.strip() or '"' in self.name:
            raise ProductError(f"{self.name!r} cannot name a coordinate system")

    @property
    def is_on_mars(self) -> bool:
        """Whether the mission is on Mars: maps of an own stereo rig are on no known body."""
        return not (self.origin and self.radius_m == 0.0)

    def untied(self, origin: str) -> LandingPoint:
        """The origin of a map of the same mission that is not tied to the lander."""
        name = f"{_ORIGIN}{origin}, not tied to {'the lander' if self.is_on_mars else 'site 0'}"
        return replace(self, name=name, source=f"{self.name} is not reached", origin=origin)


def nowhere(source: str) -> LandingPoint:
    """The origin of a map that is on no known body: site 0 of an own stereo rig."""
    name = f"{_ORIGIN}site 0, not tied to a planet"
    return LandingPoint(name, 0.0, 0.0, 0.0, source, origin="site 0")


def mars_crs(definition: str) -> CRS:
    """A CRS on Mars by its name or WKT; EPSG numbers, which are the Earth's, are rejected at once.

    geopandas would make PROJ search all of them, for 0.3 s.
    """
    return _mars_crs_type().from_user_input(definition)


@cache
def _mars_crs_type() -> type[CRS]:
    from pyproj import CRS  # noqa: PLC0415 - lists of products need no PROJ

    class MarsCrs(CRS):
        def to_epsg(self, min_confidence: int = 70) -> None:  # noqa: ARG002 - pyproj's signature
            return

    return MarsCrs


@lru_cache(maxsize=64)
def local_crs(landing: LandingPoint) -> CRS:
    """The map's CRS, east and north in metres: orthographic, or of engineering where untied."""
    axes = (
        f'CS[Cartesian,2],AXIS["(E)",east,ORDER[1],{_METRE}],AXIS["(N)",north,ORDER[2],{_METRE}]]'
    )
    if landing.origin:
        return mars_crs(f'ENGCRS["{landing.name} (east, north)",EDATUM["{landing.name}"],{axes}')
    return mars_crs(
        f'PROJCRS["{landing.name}: landing site local (east, north)",'
        f"BASEGEOGCRS[{_base(landing)}],"
        f'CONVERSION["{landing.name}: tangent plane",METHOD["Orthographic",ID["EPSG",9840]],'
        f'PARAMETER["Latitude of natural origin",{landing.latitude!r},{_DEGREE},ID["EPSG",8801]],'
        f'PARAMETER["Longitude of natural origin",{landing.longitude!r},{_DEGREE},ID["EPSG",8802]],'
        f'PARAMETER["False easting",0,{_METRE},ID["EPSG",8806]],'
        f'PARAMETER["False northing",0,{_METRE},ID["EPSG",8807]]],{axes}'
    )


_DEGREE = 'ANGLEUNIT["degree",0.0174532925199433]'
_METRE = 'LENGTHUNIT["metre",1]'


def _base(landing: LandingPoint) -> str:
    meridian = f'PRIMEM["Reference Meridian",0,{_DEGREE}]'
    if landing.radius_m == IAU_RADIUS_M:
        sphere = "Mars (2015) - Sphere"
        name, identity = f"{sphere} / Ocentric", ',ID["IAU",49900,2015]'
    else:
        sphere = f"Mars - Sphere at {landing.name}"
        name, identity = f"{sphere} / Ocentric", ""
    ellipsoid = f'ELLIPSOID["{sphere}",{landing.radius_m!r},0,{_METRE}]'
    return f'"{name}",DATUM["{sphere}",{ellipsoid}],{meridian}{identity}'


def local_proj4(landing: LandingPoint) -> str | None:
    """The same CRS as a PROJ string, for proj4js and WMTS clients; None for an untied map.

    `crs_text` gives clients a string in either case.
    """
    if landing.origin:
        return None
    return (
        f"+proj=ortho +lat_0={landing.latitude!r} +lon_0={landing.longitude!r} "
        f"+R={landing.radius_m!r} +units=m +no_defs"
    )


def untied_origin(crs: CRS) -> str | None:
    """The origin of a map that is not tied to the lander, as its CRS names it; None of others."""
    name = crs.datum.name if crs.is_engineering and crs.datum else ""
    return name if name.startswith(_ORIGIN) else None


def height_reference(crs: CRS) -> str:
    """What elevations on a map count from, in words."""
    return f"metres above the {untied_origin(crs) or 'tangent plane at the landing point'}"


def crs_text(landing: LandingPoint) -> str:
    """The CRS as one string: as PROJ string, or as WKT where the map is not tied to Mars."""
    return local_proj4(landing) or local_crs(landing).to_wkt()


@lru_cache(maxsize=64)
def _to_degrees(landing: LandingPoint) -> Transformer:
    from pyproj import Transformer  # noqa: PLC0415 - as above

    crs = local_crs(landing)
    return Transformer.from_crs(crs, crs.geodetic_crs, always_xy=True)


def lon_lat(
    landing: LandingPoint, east: PerPoint | float, north: PerPoint | float
) -> tuple[PerPoint, PerPoint]:
    """Planetocentric longitude (east) and latitude of points on the map, degrees.

    NaN on a map that is not tied to the lander.
    """
    import numpy as np  # noqa: PLC0415 - as above

    if landing.origin:
        return _nowhere(east, north)
    longitude, latitude = _to_degrees(landing).transform(np.atleast_1d(east), np.atleast_1d(north))
    return longitude, latitude


def east_north(
    landing: LandingPoint, longitude: PerPoint | float, latitude: PerPoint | float
) -> tuple[PerPoint, PerPoint]:
    """Points on the map, metres, from planetocentric longitude (east) and latitude in degrees.

    NaN on a map that is not tied to the lander.
    """
    import numpy as np  # noqa: PLC0415 - as above

    if landing.origin:
        return _nowhere(longitude, latitude)
    east, north = _to_degrees(landing).transform(
        np.atleast_1d(longitude), np.atleast_1d(latitude), direction="INVERSE"
    )
    return east, north


def _nowhere(*places: PerPoint | float) -> tuple[PerPoint, PerPoint]:
    """As many unknown points."""
    import numpy as np  # noqa: PLC0415 - as above

    shape = np.broadcast_shapes(*(np.shape(np.atleast_1d(one)) for one in places))
    return np.full(shape, np.nan), np.full(shape, np.nan)
