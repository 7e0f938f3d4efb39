"""A field rover with a stereo rig of its own: pairs, wheel odometry and the truth.

`drive_with_a_rig` renders the pairs of a drive through a rig of any model and writes what a person
would deliver: `rig.toml`, `left/` and `right/`, `poses.csv` of the wheels. The ground is a formula
with a texture of eight octaves, so that a pair takes a second and heights are known exactly.
"""

import csv
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from scipy import ndimage

from solmap.photogrammetry.archive.rig import Rig, read_rig
from solmap.photogrammetry.frames import (
    LSL,
    Pose,
    roll_pitch_yaw_of_rotation,
    rotation_of_roll_pitch_yaw,
    rover_frame,
)
from solmap.photogrammetry.imagery import Eye

SIZE = (640, 480)
SCALE = 0.01
"""Wheels count one per cent too much on sand."""
HAZE = np.deg2rad(12.0)
"""Rays that look down by less see no ground."""
NEWTON_STEPS = 12
DRIFT = np.deg2rad(0.15)
"""Of the heading, a stop."""
RIG_TOML = """mission = "{mission}"

[left]
images = "left/*.png"
model = "{model}"
size_px = [{samples}, {lines}]
focal_px = [{focal}, {focal}]
principal_px = [{x}, {y}]
distortion = {distortion}

[right]
images = "right/*.png"
model = "{model}"
size_px = [{samples}, {lines}]
focal_px = [{focal}, {focal}]
principal_px = [{x}, {y}]
distortion = {distortion}
position_m = [0.0, 0.24, 0.0]
yaw_deg = -0.3

[mount]
position_m = [0.4, -0.12, -1.1]
pitch_deg = -22.0
"""
DISTORTIONS = {
    "pinhole": [],
    "brown-conrady": [-0.28, 0.09, 0.0006, -0.0004, -0.01],
    "fisheye": [-0.012, 0.021, -0.011, 0.0024],
}


@dataclass(frozen=True, slots=True, eq=False)
class FieldDrive:
    """A folder to deliver, and what is true of it."""

    folder: Path
    true: list[Pose]
    """Pose of the rover at every stop, north, east, down."""
    wheels: list[Pose]
    """By odometry; the first is true."""


def elevation(east: np.ndarray, north: np.ndarray) -> np.ndarray:
    """Height of the ground, metres: waves of some metres and mounds of 10 to 25 cm."""
    up = 0.05 * np.sin(north / 1.3 + 0.4) + 0.06 * np.sin(east / 1.7 - 0.8)
    rng = np.random.default_rng(5)
    for _ in range(25):
        n, e, height = rng.uniform(-2, 22), rng.uniform(-6, 6), rng.uniform(0.1, 0.25)
        up = up + height * np.exp(-((north - n) ** 2 + (east - e) ** 2) / (2 * 0.35**2))
    return up


def rig_text(model: str = "brown-conrady", size: tuple[int, int] = SIZE) -> str:
    """The `rig.toml` of a rig that looks 22 degrees down from 1.1 m."""
    samples, lines = size
    return RIG_TOML.format(
        mission="FIELD",
        model=model,
        samples=samples,
        lines=lines,
        focal=0.82 * samples,
        x=0.507 * samples,
        y=0.494 * lines,
        distortion=DISTORTIONS[model],
    )


def drive_with_a_rig(
    folder: Path, stops: int, *, model: str = "brown-conrady", size: tuple[int, int] = SIZE
) -> FieldDrive:
    """Render a drive of 0.8 m from stop to stop and write its files."""
    text = rig_text(model, size)
    rig = read_rig(text, "rig.toml", str)
    headings = 0.3 * np.sin(np.arange(stops) / 3.0)
    steps = 0.8 * np.column_stack([np.cos(headings), np.sin(headings)])
    places = np.vstack([np.zeros(2), np.cumsum(steps[:-1], axis=0)])
    true = [
        _standing(place, heading, number)
        for number, (place, heading) in enumerate(zip(places, headings, strict=True), 1)
    ]
    wheels = _odometry(true)
    for eye in (Eye.LEFT, Eye.RIGHT):
        (folder / eye).mkdir(parents=True, exist_ok=True)
        rays = _rays(rig, eye, size)
        for number, pose in enumerate(true, 1):
            image = _photograph(rig.cameras[eye].camera.centre, rays, pose, number)
            cv2.imwrite(str(folder / eye / f"{number:04d}.png"), image)
    (folder / "rig.toml").write_text(text)
    write_poses(folder / "poses.csv", wheels)
    return FieldDrive(folder, true, wheels)


def write_poses(path: Path, poses: list[Pose]) -> None:
    """The poses CSV of a drive, one row per pair."""
    with path.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["image", "x_m", "y_m", "z_m", "roll_deg", "pitch_deg", "yaw_deg"])
        for number, pose in enumerate(poses, 1):
            angles = np.degrees(roll_pitch_yaw_of_rotation(pose.rotation))
            values = [f"{value:.5f}" for value in (*pose.translation_m, *angles)]
            table.writerow([f"{number:04d}.png", *values])


def _odometry(true: list[Pose]) -> list[Pose]:
    """Wheel odometry: too far and, stop by stop, turned away."""
    poses = [true[0]]
    for before, after in pairwise(true):
        step = before.rotation.T @ (after.translation_m - before.translation_m)
        drift = rotation_of_roll_pitch_yaw(0.0, 0.0, float(DRIFT))
        turn = before.rotation.T @ after.rotation @ drift
        last = poses[-1]
        poses.append(
            Pose(
                LSL,
                after.source,
                last.rotation @ turn,
                last.translation_m + last.rotation @ step * (1 + SCALE),
            )
        )
    return poses


def _standing(place: np.ndarray, heading: float, number: int) -> Pose:
    """A rover on the ground below it, tilted as wheels half a metre apart tilt it."""
    north, east = place
    ahead = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
    feet = place + 0.25 * np.vstack([ahead, -ahead])
    heights = elevation(feet[:, 1], feet[:, 0])
    pitch, roll = np.arctan2(heights[:2] - heights[2:], 0.5) * [1, -1]
    return Pose(
        LSL,
        rover_frame(0, number),
        rotation_of_roll_pitch_yaw(float(roll), float(pitch), float(heading)),
        np.array([north, east, -float(heights.mean())]),
    )


def _rays(rig: Rig, eye: Eye, size: tuple[int, int]) -> np.ndarray:
    samples, lines = size
    line, sample = np.mgrid[:lines, :samples].reshape(2, -1)
    rays = rig.cameras[eye].camera.rays(np.column_stack([sample, line]).astype(np.float64))
    return rays.reshape(lines, samples, 3)


def _photograph(
    centre_in_rover: np.ndarray, rays: np.ndarray, pose: Pose, number: int
) -> np.ndarray:
    """The image of one camera, eight bits, with the noise of a detector; haze is 200."""
    centre = pose.apply(centre_in_rover[None])[0]
    directions = rays @ pose.rotation.T
    is_ground = directions[..., 2] > np.sin(HAZE)
    towards = directions[is_ground]
    length = -centre[2] / towards[:, 2]
    for _ in range(NEWTON_STEPS):
        north, east, down = (centre + length[:, None] * towards).T
        length = length - (down + elevation(east, north)) / towards[:, 2]
    north, east, _ = (centre + length[:, None] * towards).T
    image = np.full(rays.shape[:2], 200.0)
    image[is_ground] = 110.0 + 28.0 * _texture(north, east, length / len(rays))
    image += np.random.default_rng([number, int(1e6 + 1000 * centre[1])]).normal(
        0, 0.8, image.shape
    )
    return np.clip(np.rint(image), 1, 255).astype(np.uint8)


def _texture(north: np.ndarray, east: np.ndarray, pixel_m: np.ndarray) -> np.ndarray:
    """Grains of 4 mm to half a metre; those finer than a pixel are not seen."""
    noise = np.random.default_rng(3).normal(size=(509, 509)).astype(np.float32)
    noise = cv2.GaussianBlur(noise, (0, 0), 1.0, borderType=cv2.BORDER_REFLECT)
    noise /= noise.std()
    grey = np.zeros(len(north))
    for octave in range(8):
        grain_m = 0.004 * 2**octave
        row, col = ((one / grain_m + 37.0 * octave) % 507.0 for one in (north, east))
        seen = np.clip(grain_m / (2.0 * pixel_m) - 0.5, 0.0, 1.0)
        grey += seen * ndimage.map_coordinates(noise, [row, col], order=1)
    return grey / 2.0
