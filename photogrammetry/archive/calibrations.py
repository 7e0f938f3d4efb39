"""Calibrations of a stereo rig by other programs: OpenCV, ROS, Kalibr and the Ames Stereo Pipeline.

    .tsai                 of the Ames Stereo Pipeline, one camera a file: fu fv cu cv, C and R
                          (camera into the rig's frame), no distortion or that of OpenCV
                          (k1 k2 p1 p2 [k3], TSAI), in pixels (`pitch = 1`, or none stated)
    .yaml, .yml, .xml     of Kalibr (`cam0`, `cam1` with T_cn_cnm1), of OpenCV's stereo calibration
                          (M1 D1 M2 D2 R T, as `stereo_calib` writes them), or of one camera
                          (`camera_matrix`, `distortion_coefficients`, as OpenCV and ROS do)

The frame of a rig is that of a rover: x forward, y right, z down. A .tsai file gives its camera in
this frame; in the others the left camera, or the only one, is at the origin and points along x.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Float64, Rotation, Vector3
from solmap.photogrammetry.cameras.cahv import Cahv
from solmap.photogrammetry.cameras.calibrated import BrownConrady, CalibratedCamera, Fisheye
from solmap.photogrammetry.errors import CameraError, LabelError

Camera = Cahv | CalibratedCamera
FORWARD_RIGHT_DOWN = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
"""Right, down and forward of a camera that points along x of the rig, as rows."""
MODELS = ("pinhole", "brown-conrady", "fisheye")
_OTHER_NAMES = {
    "none": "pinhole",
    "null": "pinhole",
    "radtan": "brown-conrady",
    "plumb_bob": "brown-conrady",
    "rational_polynomial": "brown-conrady",
    "tsai": "brown-conrady",
    "equi": "fisheye",
    "equidistant": "fisheye",
    "kannala_brandt": "fisheye",
}
NEARLY_ORTHONORMAL = 1e-3
"""Rotations written with only three decimals are accepted and orthonormalised."""
MAX_CHARACTERS = 1 << 20
_TSAI_DISTORTION = ("k1", "k2", "p1", "p2", "k3")
_TSAI_DIRECTIONS = {"u_direction": (1, 0, 0), "v_direction": (0, 1, 0), "w_direction": (0, 0, 1)}


@dataclass(frozen=True, slots=True, eq=False)
class CalibratedEye:
    """A camera in the frame of its rig, and the image size that it was calibrated for."""

    camera: Camera
    size: tuple[int, int] | None
    """(samples, lines); None where the calibration does not state it."""


def read_calibration(text: str, source: str) -> tuple[CalibratedEye, ...]:
    """The cameras of a calibration file: one, or the left and the right one.

    Args:
        text: the file.
        source: its name; the ending gives the format.

    Raises:
        LabelError: it cannot be read, or its camera model is unknown.
    """
    if len(text) > MAX_CHARACTERS:
        raise LabelError(f"{source}: {len(text)} characters are too many for a calibration")
    try:
        if source.lower().endswith(".tsai"):
            return (_of_tsai(text, source),)
        return _of_tree(_tree(text, source), source)
    except CameraError as error:
        raise LabelError(f"{source}: {error}") from error


@dataclass(frozen=True, slots=True)
class Lens:
    """Interior orientation as given in a calibration."""

    model: str
    """pinhole, brown-conrady or fisheye, or their names in other programs."""
    focal_px: Sequence[float]
    principal_px: Sequence[float]
    distortion: Sequence[float] = ()


def camera_of(lens: Lens, centre: Vector3, axes: Rotation, source: str) -> Camera:
    """A camera of a rig; `axes` are rows right, down, forward in the rig's frame.

    Raises:
        LabelError: the model is unknown, or its numbers are impossible.
    """
    name = _OTHER_NAMES.get(lens.model.lower(), lens.model.lower())
    if name not in MODELS:
        raise LabelError(
            f"{source}: the camera model {lens.model[:40]!a} is not known; calibrate with one of "
            f"{', '.join(MODELS)}"
        )
    axes = _right_angled(axes, source)
    fx, fy, x, y = (float(number) for number in (*lens.focal_px, *lens.principal_px))
    try:
        if name == "fisheye":
            return Fisheye(centre, axes, (fx, fy), (x, y), tuple(lens.distortion))
        if name == "brown-conrady" and np.any(lens.distortion):
            return BrownConrady(centre, axes, (fx, fy), (x, y), tuple(lens.distortion))
        right, down, forward = axes
        if np.any(lens.distortion):
            raise LabelError(f"{source}: a pinhole camera has no distortion")
        return Cahv(centre, forward, fx * right + x * forward, fy * down + y * forward)
    except CameraError as error:
        raise LabelError(f"{source}: {error}") from error


def _right_angled(axes: Rotation, source: str) -> Rotation:
    """The rotation nearest to one written with a few decimals."""
    u, _, vt = np.linalg.svd(axes)
    nearest = u @ vt
    if not (np.abs(nearest - axes).max() < NEARLY_ORTHONORMAL and np.linalg.det(nearest) > 0):
        raise LabelError(f"{source}: the rotation of its camera is not a rotation matrix")
    return nearest


def _of_tsai(text: str, source: str) -> CalibratedEye:
    fields = dict(re.findall(r"^\s*(\w+)\s*=\s*(.+?)\s*$", text, re.MULTILINE))
    words = set(re.findall(r"^\s*([A-Za-z_]+)\s*$", text, re.MULTILINE))
    unknown = sorted(words - {"PINHOLE", "TSAI", "NULL"})
    if unknown:
        raise LabelError(
            f"{source}: the distortion {unknown[0][:40]!a} is not known; write the file again "
            "with TSAI or NULL"
        )

    def numbers(name: str, count: int) -> list[float]:
        return _numbers(fields.get(name, "").split(), count, f"{source}: {name}")

    for name, expected in _TSAI_DIRECTIONS.items():
        if name in fields and not np.array_equal(numbers(name, 3), expected):
            raise LabelError(f"{source}: {name} should be {' '.join(map(str, expected))}")
    if "pitch" in fields and numbers("pitch", 1) != [1.0]:
        raise LabelError(f"{source}: pitch should be 1: focal lengths in pixels")
    focal = [numbers(name, 1)[0] for name in ("fu", "fv")]
    principal = [numbers(name, 1)[0] for name in ("cu", "cv")]
    distortion = [numbers(name, 1)[0] for name in _TSAI_DISTORTION if name in fields]
    lens, axes = Lens("tsai", focal, principal, distortion), np.array(numbers("R", 9))
    camera = camera_of(lens, np.array(numbers("C", 3)), axes.reshape(3, 3).T, source)
    return CalibratedEye(camera, None)


def _of_tree(tree: Mapping[str, Any], source: str) -> tuple[CalibratedEye, ...]:
    """The cameras of Kalibr, of OpenCV's stereo calibration, or one camera."""
    if "cam0" in tree:
        first, second = (_of_kalibr(tree, name, source) for name in ("cam0", "cam1"))
        step = [_numbers(row, 4, f"{source}: T_cn_cnm1") for row in tree["cam1"]["T_cn_cnm1"]]
        return first, _second(second, np.array(step), source)
    if {"M1", "M2", "R", "T"} <= set(tree):
        first, second = (_of_opencv(tree, f"M{k}", f"D{k}", source) for k in (1, 2))
        parts = [_matrix(tree, "R", 9, source), _matrix(tree, "T", 3, source)]
        return first, _second(second, np.column_stack(parts), source)
    if "camera_matrix" in tree:
        return (_of_opencv(tree, "camera_matrix", "distortion_coefficients", source),)
    raise LabelError(
        f"{source}: not a known calibration: it has neither cam0 (Kalibr) nor M1, M2, R, T nor "
        "camera_matrix (OpenCV)"
    )


def _second(
    eye: CalibratedEye, second_from_first: Float64[np.ndarray, "_ 4"], source: str
) -> CalibratedEye:
    """The second camera of a rig by its motion from the first, which is at the origin."""
    turn = _right_angled(second_from_first[:3, :3], source)
    axes = turn @ FORWARD_RIGHT_DOWN
    centre = -axes.T @ second_from_first[:3, 3]
    camera = eye.camera
    if isinstance(camera, Cahv):
        h, v, a = np.stack([camera.h, camera.v, camera.a]) @ FORWARD_RIGHT_DOWN.T @ axes
        return CalibratedEye(Cahv(centre, a, h, v), eye.size)
    lens = camera.focal_px, camera.principal_px, camera.distortion
    return CalibratedEye(type(camera)(centre, axes, *lens), eye.size)


def _of_kalibr(tree: Mapping[str, Any], name: str, source: str) -> CalibratedEye:
    camera = tree.get(name)
    if not isinstance(camera, dict) or (name == "cam1" and "T_cn_cnm1" not in camera):
        raise LabelError(f"{source}: {name} is missing; export the camera chain of both cameras")
    model = str(camera.get("camera_model"))
    if model != "pinhole":
        raise LabelError(
            f"{source}: the camera model {model[:40]!a} of {name} is not known; calibrate with "
            "pinhole-radtan or pinhole-equi"
        )
    fx, fy, x, y = _numbers(camera.get("intrinsics"), 4, f"{source}: intrinsics of {name}")
    size = _numbers(camera.get("resolution"), 2, f"{source}: resolution of {name}")
    distortion = _numbers(
        camera.get("distortion_coeffs", []), None, f"{source}: distortion of {name}"
    )
    lens = Lens(str(camera.get("distortion_model", "none")), (fx, fy), (x, y), distortion)
    made = camera_of(lens, np.zeros(3), FORWARD_RIGHT_DOWN, source)
    return CalibratedEye(made, (int(size[0]), int(size[1])))


def _of_opencv(
    tree: Mapping[str, Any], matrix: str, coefficients: str, source: str
) -> CalibratedEye:
    (fx, skew, x), (_, fy, y), _ = _matrix(tree, matrix, 9, source)
    if skew != 0:
        raise LabelError(f"{source}: {matrix} has skew, which no camera model here supports")
    values = tree.get(coefficients, {"data": []})
    distortion = _numbers(_data(values), None, f"{source}: {coefficients}")
    if len(distortion) > 8 and not np.any(distortion[8:]):  # noqa: PLR2004 - thin prisms and tilt
        distortion = distortion[:8]
    sizes = [tree.get("image_width"), tree.get("image_height")]
    size = None if None in sizes else tuple(map(int, _numbers(sizes, 2, f"{source}: image_width")))
    lens = Lens(str(tree.get("distortion_model", "plumb_bob")), (fx, fy), (x, y), distortion)
    camera = camera_of(lens, np.zeros(3), FORWARD_RIGHT_DOWN, source)
    return CalibratedEye(camera, None if size is None else (size[0], size[1]))


def _matrix(
    tree: Mapping[str, Any], name: str, count: int, source: str
) -> Float64[np.ndarray, "3 _"]:
    values = _numbers(_data(tree.get(name)), count, f"{source}: {name}")
    return np.array(values).reshape(3, -1)


def _data(matrix: Any) -> Any:  # noqa: ANN401 - as a file has it
    return matrix.get("data") if isinstance(matrix, dict) else matrix


def _numbers(values: Any, count: int | None, what: str) -> list[float]:  # noqa: ANN401 - as above
    """A list of a number of finite values; None: any number of them."""
    given = list(values) if isinstance(values, list) else []
    try:
        numbers = [float(value) for value in given]
    except (TypeError, ValueError):
        numbers = []
    if len(numbers) != (len(given) if count is None else count) or not np.isfinite(numbers).all():
        expected = "numbers" if count is None else f"{count} number{'s' * (count > 1)}"
        raise LabelError(f"{what} should be {expected}, but is {values!a:.60}")
    return numbers


def _tree(text: str, source: str) -> dict[str, Any]:
    """The values of a YAML or XML file, read by OpenCV.

    OpenCV's YAML needs a first line of its own and list items indented below their key.
    """
    if not text.lstrip().startswith(("%YAML", "<?xml")):
        text = "%YAML:1.0\n---\n" + re.sub(r"^( *)- ", r"\1    - ", text, flags=re.MULTILINE)
    try:
        file = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        tree = _values(file.root()) if file.isOpened() else None
    except (cv2.error, SystemError, UnicodeDecodeError):
        tree = None
    if not isinstance(tree, dict):
        raise LabelError(
            f"{source}: cannot be read as a calibration: .tsai, or YAML or XML of OpenCV or Kalibr"
        )
    return tree


def _values(node: cv2.FileNode) -> Any:  # noqa: ANN401 - as a file has it
    if node.isMap():
        return {name: _values(node.getNode(name)) for name in node.keys()}  # noqa: SIM118
    if node.isSeq():
        return [_values(node.at(k)) for k in range(node.size())]
    if node.isString():
        return node.string()
    return node.real() if node.isInt() or node.isReal() else None
