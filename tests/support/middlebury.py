"""Dense matching against OpenCV's StereoSGBM on Middlebury's images, at equal fill.

    python -m tests.support.middlebury

reads from `.cache/middlebury` motorcycle_{left,right}.png and motorcycle_disp.npz, the data of
scikit-image 0.16; cones_{left,right}.png and cones_disp.tif, which are left.png, right.png and
disp_left.tif in the source package of pandora 1.9; and aloe{L,R}.jpg and aloeGT.png, the samples of
OpenCV's source package. Aloe has truth in whole pixels; at a third of its size, as Middlebury
evaluates it, these are thirds.

Truth and images of a scene may be shifted against each other, which both matchers show: the shift
at which the images agree best under the truth, without any matcher, is added to it.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.frames import Frame, FrameKind, Pose, rover_frame
from solmap.photogrammetry.matching.records import EpipolarImages
from solmap.photogrammetry.matching.stereo.dense import DenseParams, match_densely
from tests.support.plain_stereo import plainly_wrong_at, wrong_and_filled
from tests.support.simulated_stops import ROOT

FOLDER = ROOT / ".cache" / "middlebury"
FOCAL_PX, BASE_M = 1000.0, 0.2
SHIFTS_PX = np.arange(-1.0, 1.01, 0.125)
EVEN_PX = 3.0
"""Largest step of parallax over the window of the shift; larger ones are edges of surfaces."""


@dataclass(frozen=True, slots=True)
class Scene:
    """A pair of images with the parallax of the left one."""

    name: str
    files: tuple[str, str, str]
    """Left, right, truth."""
    search_px: int
    """Largest parallax that is searched."""
    truth_step_px: float = 0.0
    """To which the truth is rounded."""
    reduced: int = 1
    """Pixels averaged to one, in both directions."""

    @property
    def paths(self) -> list[Path]:
        """The files."""
        return [FOLDER / name for name in self.files]

    @property
    def is_here(self) -> bool:
        """Whether all of them are there."""
        return all(path.exists() for path in self.paths)


ALOE = ("aloeL.jpg", "aloeR.jpg", "aloeGT.png")
MOTORCYCLE = Scene(
    "motorcycle", ("motorcycle_left.png", "motorcycle_right.png", "motorcycle_disp.npz"), 72
)
SCENES = (
    MOTORCYCLE,
    Scene("cones", ("cones_left.png", "cones_right.png", "cones_disp.tif"), 64, 0.25),
    Scene("aloe, third size", ALOE, 75, 1 / 3, 3),
    Scene("aloe", ALOE, 224, 1.0),
)


@dataclass(frozen=True, slots=True)
class Comparison:
    """Dense matching and StereoSGBM on one scene."""

    filled: float
    wrong: dict[float, tuple[float, float]]
    """Shares of filled pixels that are wrong by more than a limit in pixels: ours, StereoSGBM's."""
    sigmas: float
    """Robust standard deviation of the errors in units of the stated one, 1 if that is right; the
    rounding of the truth is added to the latter."""
    shift_px: float
    """Added to the truth."""

    def __str__(self) -> str:
        wrong = ", ".join(
            f"{ours:.2%} (SGBM {theirs:.2%}) wrong by more than {limit:g} px"
            for limit, (ours, theirs) in self.wrong.items()
        )
        return (
            f"{self.filled:.1%} filled, {wrong}, error {self.sigmas:.2f} sigma; truth shifted by "
            f"{self.shift_px:.2f} px"
        )


def compared(scene: Scene) -> Comparison:
    """Match a scene with both."""
    left, right = (cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in scene.paths[:2])
    truth = _truth(scene.paths[2])
    if scene.reduced > 1:
        k = scene.reduced
        lines, samples = (side // k * k for side in left.shape)
        left, right = (
            image[:lines, :samples].reshape(lines // k, k, samples // k, k).mean(axis=(1, 3))
            for image in (left, right)
        )
        truth = truth[k // 2 : lines : k, k // 2 : samples : k] / k
    lines, samples = left.shape
    pose = Pose(rover_frame(1, 0), Frame(FrameKind.PAIR, (1,)), np.eye(3), np.zeros(3))
    centre = ((samples - 1) / 2, (lines - 1) / 2)
    geometry = EpipolarPair(pose, BASE_M, FOCAL_PX, centre, samples, lines)
    whole = np.ones(left.shape, dtype=bool)
    images = EpipolarImages(
        geometry, left.astype(np.float32), whole, right.astype(np.float32), whole.copy()
    )
    visible = seen_by_both(truth)
    shift = shift_of_truth(images, truth, visible)
    truth = truth + np.float32(shift)
    nearest_m = FOCAL_PX * BASE_M / scene.search_px
    dense = match_densely(images, DenseParams(nearest_range_m=nearest_m))
    filled = wrong_and_filled(dense.parallax_px, truth, visible)[1]
    wrong = {
        limit: (
            wrong_and_filled(dense.parallax_px, truth, visible, limit)[0],
            plainly_wrong_at(filled, images, truth, visible, nearest_m, limit),
        )
        for limit in (1.0, 2.0)
    }
    sigma_px = np.hypot(dense.sigma_px, scene.truth_step_px / 12**0.5)
    normalised = (np.abs(dense.parallax_px - truth) / sigma_px)[visible]
    return Comparison(filled, wrong, float(1.4826 * np.nanmedian(normalised)), shift)


def _truth(path: Path) -> np.ndarray:
    """Parallax of the left image, pixels; NaN where it is not known."""
    if path.suffix == ".npz":
        (truth,) = np.load(path).values()
    else:
        truth = cv2.imread(str(path), cv2.IMREAD_ANYDEPTH)
    return np.where(np.isfinite(truth) & (truth > 0), truth, np.nan).astype(np.float32)


def seen_by_both(truth: np.ndarray) -> np.ndarray:
    """Pixels whose partner in the right image shows no nearer surface."""
    line, sample = np.nonzero(np.isfinite(truth))
    parallax = truth[line, sample]
    partner = np.rint(sample - parallax).astype(int)
    line, sample, partner, parallax = (v[partner >= 0] for v in (line, sample, partner, parallax))
    nearest = np.full(truth.shape, -np.inf, np.float32)
    np.maximum.at(nearest, (line, partner), parallax)
    seen = np.zeros(truth.shape, dtype=bool)
    seen[line, sample] = nearest[line, partner] - parallax < 1
    return seen


def shift_of_truth(images: EpipolarImages, truth: np.ndarray, visible: np.ndarray) -> float:
    """Shift of the truth, pixels, under which both images are most alike away from edges."""
    window = np.ones((9, 9), np.uint8)
    known = np.where(np.isfinite(truth), truth, 0).astype(np.float32)
    even = cv2.dilate(known, window) - cv2.erode(known, window) < EVEN_PX
    even &= cv2.erode(visible.astype(np.uint8), window) > 0
    left, right = (grey - cv2.blur(grey, (31, 31)) for grey in (images.left, images.right))
    line, sample = np.indices(left.shape, dtype=np.float32)
    unlike = []
    for shift in SHIFTS_PX:
        there = cv2.remap(right, sample - known - np.float32(shift), line, cv2.INTER_CUBIC)
        unlike.append(np.mean(np.clip(left - there, -30, 30)[even] ** 2))
    least = int(np.argmin(unlike))
    near = slice(max(0, least - 3), least + 4)
    square, linear, _ = np.polyfit(SHIFTS_PX[near], unlike[near], 2)
    return float(-linear / (2 * square))


def figures() -> Iterator[str]:
    """A line for every scene."""
    for scene in SCENES:
        figures_of_scene = (
            str(compared(scene)) if scene.is_here else f"needs {', '.join(scene.files)}"
        )
        yield f"{scene.name}: {figures_of_scene}"


if __name__ == "__main__":
    for line in figures():
        print(line, flush=True)  # noqa: T201 - figures are what this makes
