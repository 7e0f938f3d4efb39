"""Poses out of SPICE kernels that the tests write themselves."""

from __future__ import annotations

import builtins

import numpy as np
import pytest

from solmap.photogrammetry.archive.tables.spice_kernels import open_kernels
from solmap.photogrammetry.errors import VectorFileError
from solmap.photogrammetry.frames import rotation_of_quaternion, rotation_of_roll_pitch_yaw
from tests.support.spice_kernels import CLOCK, write_kernels

spiceypy = pytest.importorskip("spiceypy", reason="the optional extra `spice` is not installed")
PLACE_M = np.array([120.0, -45.5, 3.25])
ATTITUDE = rotation_of_roll_pitch_yaw(*np.radians([2.0, -3.0, 130.0]))


def test_position_and_attitude_are_read_back(tmp_path):
    with open_kernels(write_kernels(tmp_path, PLACE_M, ATTITUDE)) as kernels:
        quaternion, position_m = kernels.pose("MER2", CLOCK + 0.5)
    np.testing.assert_allclose(position_m, PLACE_M, atol=1e-6)  # SPK keeps kilometres in doubles
    np.testing.assert_allclose(rotation_of_quaternion(quaternion), ATTITUDE, atol=1e-9)
    assert spiceypy.ktotal("ALL") == 0


def test_a_time_outside_the_kernels_has_no_pose(tmp_path):
    with open_kernels(write_kernels(tmp_path, PLACE_M, ATTITUDE)) as kernels:
        assert kernels.pose("MER2", CLOCK + 1e6) is None


def test_a_missing_kernel_is_named(tmp_path):
    files = write_kernels(tmp_path, PLACE_M, ATTITUDE)
    for suffix, wrong in {".tf": "frames kernel", ".tsc": "clock", ".tls": "clock"}.items():
        some = [file for file in files if file.suffix != suffix]
        with open_kernels(some) as kernels, pytest.raises(VectorFileError, match=wrong):
            kernels.pose("MER2", CLOCK)
    with open_kernels(files) as kernels, pytest.raises(VectorFileError, match="NAIF number of K10"):
        kernels.pose("K10", CLOCK)


def test_a_file_that_is_not_a_kernel_is_refused_by_name(tmp_path):
    file = tmp_path / "broken.bsp"
    file.write_bytes(bytes(3000))
    with (
        pytest.raises(VectorFileError, match=r"broken\.bsp: not a SPICE kernel"),
        open_kernels([file]),
    ):
        pass
    assert spiceypy.ktotal("ALL") == 0


def test_without_spiceypy_the_extra_is_named(tmp_path, monkeypatch):
    found = builtins.__import__

    def refuse(name, *rest):
        if name == "spiceypy":
            raise ImportError(name)
        return found(name, *rest)

    monkeypatch.setattr(builtins, "__import__", refuse)
    with (
        pytest.raises(VectorFileError, match=r"pip install 'solmap\[spice\]'"),
        open_kernels([tmp_path / "a.bc"]),
    ):
        pass
