"""Stereo pairs read by tests, resampled to epipolar geometry."""

from __future__ import annotations

from solmap.photogrammetry.archive.images.reading import ReadImage
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.matching.records import EpipolarImages
from solmap.photogrammetry.matching.resampling import epipolar_images


def resample_pair(left: ReadImage, right: ReadImage, geometry: EpipolarPair) -> EpipolarImages:
    """Both images in the geometry of their pair."""
    return epipolar_images(
        geometry, *((eye.pixels, eye.mask, eye.image.camera) for eye in (left, right))
    )
