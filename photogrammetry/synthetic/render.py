"""Images of a heightfield: a swept cylindrical panorama, resampled into the camera.

Around a camera at height z_c every azimuth is a profile. A point of the profile at distance r has
the tangent of elevation m, with the running maximum M,

    m(r) = (z(r) - z_c) / r          M(r) = max over r' <= r of m(r'),

and is hidden exactly where m < M. So M, which only grows, is the elevation of the horizon up to r,
and with the radiance L the light collected below the tangent m' is the integral of L over M,

    P(M(r_i)) = sum over j <= i of L_j (M_j - M_{j-1}),

piecewise linear in M. The value of a pixel between two tangents is the difference of P divided by
that of the tangents: an area integral, with occlusion, without aliasing at any distance. Steps of r
cover less than a panorama element nearby and at most one cell of the ground.

The panorama (elements of half a pixel) is smoothed to the width of a pixel and interpolated along
the camera's rays. Both cameras and all stops use the same surface, the bilinear one of the lattice.

The rover's own body, if included, covers the ground behind it (`body`). The exposure gives level
ground about 1800 of 4095; with the radiance L the signal of the camera (`camera`) is g L B, where

    B = 1 + 0.35 / (1 + tan(phase / 2) / 0.12)

is the brightening opposite the sun (Hapke 1986).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Float32, Float64, GreyImage, Int32, ObjectPoints, Vector3
from solmap.photogrammetry.errors import CameraError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.imagery import Eye
from solmap.photogrammetry.synthetic.body import body_radiance, entered
from solmap.photogrammetry.synthetic.camera import SHARPEST_PX, compress, expose, transmission
from solmap.photogrammetry.synthetic.lattice import Window, bilinear, stream_of
from solmap.photogrammetry.synthetic.lighting import GRAIN_M, GRAINS, SKY_LIGHT, LitGround, Sun
from solmap.photogrammetry.synthetic.rig import CAMERAS, FULL_FRAME, Instrument, RigErrors
from solmap.photogrammetry.synthetic.scene import Shot, World

CHUNK = 64
"""Azimuths processed together, so that their profiles fit the processor's cache."""
STEEPEST = np.deg2rad(75.0)
GRAIN_REACH_M = (6.0, 12.0, 24.0)
"""Distances up to which the grains are sampled at 4, 8, 16 mm."""

Rays = Float32[np.ndarray, "3 lines samples"]
"""(north, east, down) of the unit direction of every pixel."""
LEVEL_DN = 1800.0


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """Directions of an image's pixels, as azimuth from its middle and tangent of elevation."""

    centre: Vector3
    """(north, east, down) of the camera in the LSL."""
    heading: float
    azimuth: GreyImage
    elevation: GreyImage
    step: float
    """Angle of a panorama element, radians."""

    @classmethod
    def of_rays(cls, centre: Vector3, rays: Rays, pixel_rad: float) -> View:
        """The view of a camera whose pixels have the directions `rays`.

        Raises:
            CameraError: a ray points steeper down than a panorama covers.
        """
        north, east, down = rays
        middle = rays[:, rays.shape[1] // 2, rays.shape[2] // 2].astype(np.float64)
        heading = float(np.arctan2(middle[1], middle[0]))
        c, s = np.float32(np.cos(heading)), np.float32(np.sin(heading))
        forward, right = c * north + s * east, c * east - s * north
        azimuth = np.arctan2(right, forward)
        elevation = np.arctan2(-down, np.sqrt(forward * forward + right * right))
        if elevation.min() < -STEEPEST:
            raise CameraError(
                f"a ray points {np.rad2deg(-elevation.min()):.0f} degrees down; the panorama "
                f"covers {np.rad2deg(STEEPEST):.0f} at most: raise the mast's elevation"
            )
        return cls(centre, heading, azimuth, elevation, 0.5 * pixel_rad)

    @property
    def azimuths(self) -> Float64[np.ndarray, " columns"]:
        """Azimuth of every panorama column, from the heading."""
        first = np.floor(float(self.azimuth.min()) / self.step) - 2
        last = np.ceil(float(self.azimuth.max()) / self.step) + 2
        return np.arange(first, last + 1) * self.step

    @property
    def edges(self) -> Float64[np.ndarray, " edges"]:
        """Elevations between which the panorama elements lie."""
        first = np.floor(float(self.elevation.min()) / self.step) - 2
        last = np.ceil(float(self.elevation.max()) / self.step) + 2
        return (np.arange(first, last + 2) - 0.5) * self.step


@dataclass(frozen=True, slots=True, eq=False)
class Profiles:
    """Profiles over the ground at some azimuths: distances, horizon and radiance."""

    distance_m: Float64[np.ndarray, " steps"]
    horizon: Float32[np.ndarray, "columns steps"]
    radiance: Float32[np.ndarray, "columns steps"]


def rotate_rays(pose: Pose, rays: Rays) -> Rays:
    """Rays in the target frame of a pose, summed in a fixed order on every platform."""
    r = pose.rotation.astype(np.float32)
    return np.stack([r[i, 0] * rays[0] + r[i, 1] * rays[1] + r[i, 2] * rays[2] for i in range(3)])


def render_radiance(ground: LitGround, view: View, psf_px: float = SHARPEST_PX) -> GreyImage:
    """Radiance of every pixel; the ground of albedo 1 under a vertical sun has about 1.2."""
    azimuths, edges = view.azimuths, view.edges
    tangents = np.tan(edges)
    panorama = np.empty((len(azimuths), len(edges) - 1), np.float32)
    steps = _steps(ground, view)
    for start in range(0, len(azimuths), CHUNK):
        profiles = _sweep(ground, view, azimuths[start : start + CHUNK], steps)
        panorama[start : start + CHUNK] = _collect_light(ground, profiles, tangents)
    smooth = _spread(panorama, psf_px)
    scale = np.float32(1 / view.step)
    column = (view.azimuth - np.float32(azimuths[0])) * scale
    row = (view.elevation - np.float32(edges[0] + 0.5 * view.step)) * scale
    return cv2.remap(smooth, row, column, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def _spread(panorama: GreyImage, psf_px: float) -> GreyImage:
    """The panorama smoothed to the requested width of a point's image.

    Elements of half a pixel and the bilinear sampling between them add 1/12 + 1/6 of an element's
    square to the variance, and the narrowest kernel 1/2: `SHARPEST_PX`.
    """
    kernel = np.array([0.25, 0.5, 0.25])
    if psf_px > SHARPEST_PX:
        sigma = np.sqrt(4 * psf_px**2 - 0.25)
        reach = int(np.ceil(4 * sigma))
        kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
        kernel /= kernel.sum()
    return cv2.sepFilter2D(panorama, -1, kernel, kernel)


def _steps(ground: LitGround, view: View) -> list[np.ndarray]:
    """Distances at which the profiles are sampled, layer by layer."""
    z_c, steepest = -view.centre[2], -np.tan(view.edges[0])
    below = bilinear(
        ground.layers[0].elevation,
        *ground.layers[0].window.nodes_of(view.centre[0:1], view.centre[1:2]),
    )
    height_m = z_c - float(below[0])
    r = max(0.3, 0.3 * height_m / max(steepest, 0.02))
    steps = []
    for layer in ground.layers:
        cell_m, here = layer.window.cell_m, []
        while r < layer.reach_m:
            here.append(r)
            r += min(r * r * view.step / height_m, cell_m)
        steps.append(np.array(here))
    return steps


def _sweep(
    ground: LitGround, view: View, azimuths: np.ndarray, steps: list[np.ndarray]
) -> Profiles:
    c, s = np.cos(view.heading + azimuths), np.sin(view.heading + azimuths)
    horizons, radiances = [], []
    for layer, r in zip(ground.layers, steps, strict=True):
        row, col = _nodes(layer.window, view.centre, c, s, r)
        z: np.ndarray = cv2.remap(layer.elevation, col, row, cv2.INTER_LINEAR)
        z += np.float32(view.centre[2])
        z *= (1 / r).astype(np.float32)
        horizons.append(z)
        radiances.append(cv2.remap(layer.radiance, col, row, cv2.INTER_LINEAR))
    _lay_grains(ground, view, (c, s), steps[0], radiances[0])
    horizon = np.concatenate(horizons, axis=1)
    np.maximum.accumulate(horizon, axis=1, out=horizon)
    return Profiles(np.concatenate(steps), horizon, np.concatenate(radiances, axis=1))


def _nodes(
    window: Window, centre: Vector3, c: np.ndarray, s: np.ndarray, r: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    row, col = window.nodes_of(centre[0:1], centre[1:2])
    along = (r / window.cell_m).astype(np.float32)
    rows = c.astype(np.float32)[:, None] * along + row.astype(np.float32)
    return rows, s.astype(np.float32)[:, None] * along + col.astype(np.float32)


def _lay_grains(
    ground: LitGround,
    view: View,
    direction: tuple[np.ndarray, np.ndarray],
    r: np.ndarray,
    radiance: np.ndarray,
) -> None:
    """Multiply the radiance of near ground by that of its grains."""
    first = 0
    for octave, (grains, reach_m) in enumerate(zip(ground.grains, GRAIN_REACH_M, strict=True)):
        last = int(np.searchsorted(r, reach_m))
        if last > first:
            grain_m, period = GRAIN_M * 2**octave, GRAINS >> octave
            along = (r[first:last] / grain_m).astype(np.float32)
            # The middle of a coarse grain is half a coarse grain from its edge, like that of a
            # fine one.
            shift = 0.5 * (1 - 2.0**-octave)
            at = [
                part.astype(np.float32)[:, None] * along + np.float32(offset / grain_m % period)
                for part, offset in zip(direction, view.centre[:2], strict=True)
            ]
            row, col = (_wrap_node(node - np.float32(shift), period) for node in at)
            radiance[:, first:last] *= cv2.remap(grains, col, row, cv2.INTER_LINEAR)
        first = max(first, last)


def _wrap_node(node: np.ndarray, period: int) -> np.ndarray:
    """Index of a node in a periodic texture."""
    node -= np.floor(node * np.float32(1 / period)) * np.float32(period)
    return node


def _collect_light(ground: LitGround, profiles: Profiles, tangents: np.ndarray) -> np.ndarray:
    """Mean radiance between neighbouring tangents."""
    horizon = profiles.horizon.astype(np.float64)
    light = np.diff(horizon, axis=1)
    light *= 0.5 * (profiles.radiance[:, 1:] + profiles.radiance[:, :-1])
    light = np.cumsum(light, axis=1)
    sky = ground.sky(tangents)
    sky_below = np.concatenate([[0], np.cumsum(0.5 * (sky[1:] + sky[:-1]) * np.diff(tangents))])
    widths = np.diff(tangents)
    elements = np.empty((len(horizon), len(widths)), np.float32)
    for k, (m, p) in enumerate(zip(horizon, light, strict=True)):
        below = np.interp(tangents, m[1:], p)
        skyline = np.interp(m[-1], tangents, sky_below)
        below += np.maximum(sky_below - skyline, 0)
        elements[k] = np.diff(below) / widths
    return elements


def first_hits(ground: LitGround, view: View) -> ObjectPoints:
    """Intersections of the pixels' rays with the ground, (north, east, down) in the LSL.

    Rows are NaN for the sky, and where no point of the ground was found on the ray to 0.5 mm,
    which happens at outlines only.
    """
    azimuths, steps = view.azimuths, _steps(ground, view)
    column = np.rint((view.azimuth - azimuths[0]) / view.step).astype(int).ravel()
    tangent = np.tan(view.elevation.astype(np.float64)).ravel()
    bracket = np.full((3, *tangent.shape), np.nan)
    order = np.argsort(column, kind="stable")
    bounds = np.searchsorted(column[order], np.arange(len(azimuths) + 1))
    for start in range(0, len(azimuths), CHUNK):
        profiles = _sweep(ground, view, azimuths[start : start + CHUNK], steps)
        for k, horizon in enumerate(profiles.horizon, start):
            here = order[bounds[k] : bounds[k + 1]]
            index = np.searchsorted(horizon, tangent[here])
            seen = (index > 1) & (index < len(horizon) - 1)
            for row, offset in enumerate((-2, 0, 1)):
                bracket[row, here[seen]] = profiles.distance_m[index[seen] + offset]
    return _refine_hits(ground, view, tangent, bracket)


def _refine_hits(
    ground: LitGround, view: View, tangent: np.ndarray, bracket: np.ndarray
) -> ObjectPoints:
    """The zero of z(r) - z_c - m r along every ray, in its bracket of samples."""
    azimuth = view.heading + view.azimuth.astype(np.float64).ravel()
    c, s = np.cos(azimuth), np.sin(azimuth)
    behind, near, ahead = bracket

    def gap(r: np.ndarray) -> np.ndarray:
        z = _elevation(ground, view.centre[0] + r * c, view.centre[1] + r * s, near)
        return z + view.centre[2] - tangent * r

    f_behind, f_ahead = gap(behind), gap(ahead)
    for _ in range(7):  # bisection: the ground is only piecewise smooth
        middle = 0.5 * (behind + ahead)
        f = gap(middle)
        above = f < 0
        behind, f_behind = np.where(above, middle, behind), np.where(above, f, f_behind)
        ahead, f_ahead = np.where(above, ahead, middle), np.where(above, f_ahead, f)
    r = behind - f_behind * (ahead - behind) / np.where(f_ahead > f_behind, f_ahead - f_behind, 1.0)
    r = np.where(np.abs(gap(r)) < 5e-4, r, np.nan)  # noqa: PLR2004 - half a millimetre
    north, east = view.centre[0] + r * c, view.centre[1] + r * s
    return np.column_stack([north, east, view.centre[2] - tangent * r])


def _elevation(
    ground: LitGround, north: np.ndarray, east: np.ndarray, distance_m: np.ndarray
) -> np.ndarray:
    """Elevation in the layer that the distance belongs to."""
    z = np.full(north.shape, np.nan)
    inner = 0.0
    for layer in ground.layers:
        here = (distance_m >= inner) & (distance_m < layer.reach_m)
        at = layer.window.nodes_of(north[here], east[here])
        z[here] = bilinear(layer.elevation, *at)
        inner = layer.reach_m
    return z


def photograph(world: World, shot: Shot, eye: Eye) -> Int32[np.ndarray, "lines samples"]:
    """Render the pixels of one image."""
    sun, camera = world.stops[shot.stop].sun, world.params.camera
    view, rays = view_of(world, shot, eye)
    gain = LEVEL_DN / (np.sin(sun.elevation) + SKY_LIGHT)
    signal = render_radiance(world.ground(shot.stop), view, camera.psf_px)
    signal *= _opposition(rays, sun)
    if world.params.rover_in_view:
        _draw_rover(signal, view.centre, rays, world, shot)
    signal *= np.float32(gain)
    number = 0 if eye is Eye.LEFT else 1
    optics = (world.seed, 107, number, 0 if shot.instrument is Instrument.NAVCAM else 1)
    passed = transmission(camera, len(signal), *optics)
    rng = stream_of(world.seed, 106, shot.stop, shot.pair, number)
    pixels = expose(signal, passed, world.params.averaging, rng)
    return compress(pixels, camera.bits_per_pixel) if camera.bits_per_pixel else pixels


def _draw_rover(signal: GreyImage, centre: Vector3, rays: Rays, world: World, shot: Shot) -> None:
    """Draw the rover over the ground it hides, with edges as wide as the image of a point."""
    stop = world.stops[shot.stop]
    rover_from_lsl = stop.lsl_from_rover.inverse
    origin = rover_from_lsl.apply(centre[None])[0]
    turned = rotate_rays(rover_from_lsl, rays).reshape(3, -1).T
    distance, normals = entered(origin, turned)
    hit = np.isfinite(distance)
    if not hit.any():
        return
    points = origin.astype(np.float32) + distance[hit, None] * turned[hit]
    towards = (stop.sun.direction * [1, 1, -1]) @ stop.lsl_from_rover.rotation
    shown = np.zeros(signal.size, np.float32)
    shown[hit] = body_radiance(points, normals[hit], towards, SKY_LIGHT)
    layers = (hit.astype(np.float32).reshape(signal.shape), shown.reshape(signal.shape))
    sigma = world.params.camera.psf_px
    cover, light = (cv2.GaussianBlur(layer, (0, 0), sigma) for layer in layers)
    signal *= 1 - cover
    signal += light


def _opposition(rays: Rays, sun: Sun) -> GreyImage:
    north, east, up = (np.float32(part) for part in sun.direction)
    cosine = up * rays[2] - north * rays[0] - east * rays[1]
    tangent = np.sqrt(np.maximum(1 - cosine, 0) / np.maximum(1 + cosine, np.float32(1e-6)))
    return 1 + np.float32(0.35) / (1 + tangent * np.float32(1 / 0.12))


def view_of(world: World, shot: Shot, eye: Eye) -> tuple[View, Rays]:
    """True directions of the pixels of one image."""
    pose = world.true_lsl_from_mast(shot)
    rig, celsius, averaging = world.params.rig, world.celsius(shot.stop), world.params.averaging
    in_mast = _rays_in_mast(rig, celsius, shot.instrument, eye, averaging)
    rays = rotate_rays(pose, in_mast)
    centre = pose.apply(CAMERAS[shot.instrument, eye].in_mast.c[None])[0]
    return View.of_rays(centre, rays, _pixel_rad(shot.instrument, world.params.averaging)), rays


def _pixel_rad(instrument: Instrument, averaging: int) -> float:
    h = CAMERAS[instrument, Eye.LEFT].in_mast.h
    return averaging / float(np.linalg.norm(h - h[0] * np.array([1.0, 0, 0])))


@lru_cache(maxsize=4)
def _rays_in_mast(
    rig: RigErrors, celsius: float, instrument: Instrument, eye: Eye, averaging: int
) -> Rays:
    camera = rig.camera_in_mast(instrument, eye, celsius).average(averaging, averaging)
    side = FULL_FRAME // averaging
    line, sample = np.mgrid[:side, :side].reshape(2, -1)
    rays = camera.rays(np.column_stack([sample, line]).astype(np.float64))
    return np.ascontiguousarray(rays.T, np.float32).reshape(3, side, side)
