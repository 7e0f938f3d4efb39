"""`solmap inspect` reports what label, camera model and pixels of an image contain."""

import json
import math
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from solmap.flows.cli import app
from solmap.flows.cli.inspection import (
    InspectionError,
    inspect_file,
    inspect_files,
    write_linearised,
    write_png,
)
from solmap.flows.cli.inspection_text import report_of
from solmap.photogrammetry.archive.images.reading import read_image
from solmap.photogrammetry.cameras.linearisation import linearise_image, linearise_pair
from solmap.photogrammetry.stretching import stretch
from solmap.photogrammetry.synthetic.downlink import render_jobs
from solmap.photogrammetry.synthetic.scene import WorldParams, make_world
from solmap.photogrammetry.synthetic.traverse import TraverseParams
from tests.support.small_downlink import rendered_images

PARAMS = WorldParams("plains", TraverseParams(stops=1), pairs=1, averaging=4)
SEED = 5
SPIRIT = "mer_spirit_sol1869_troy/2n292280938effb100p0703l0m1.img"


@pytest.fixture(scope="module")
def world():
    """A stereo pair of a synthetic world, and what is true of it."""
    return make_world(PARAMS, SEED)


@pytest.fixture(scope="module")
def rendered(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("pair")
    for file in rendered_images(PARAMS, SEED):
        (folder / Path(file.path).name).write_bytes(file.data)
    return folder


@pytest.fixture
def pair(rendered, tmp_path) -> tuple[Path, Path]:
    """Left and right image in a folder of their own."""
    left, right = sorted(Path(shutil.copytree(rendered, tmp_path / "pair")).iterdir())
    return left, right


def test_directions_of_a_real_image_agree_with_the_published_ones(shared_data):
    """Of the mast's x axis, computed from the quaternions of the label."""
    found = inspect_file(shared_data / SPIRIT)
    mast = found["pointing"]["mast"]
    assert mast["in_rover_deg"] == pytest.approx([141.994, -25.7423], abs=2e-3)  # six digits
    assert mast["in_site_deg"] == pytest.approx([144.0022, -16.9834], abs=2e-3)
    assert found["rover"]["roll_pitch_yaw_deg"] == pytest.approx(
        [-11.08874, -2.19743, 5.03125], abs=1e-4
    )
    assert found["sun"]["in_site_deg"] == pytest.approx([131.496, 78.801])


def test_a_real_image_is_described(shared_data):
    found = inspect_file(shared_data / SPIRIT)
    assert (found["mission"], found["sol"], found["site"], found["drive"]) == ("MER2", 1869, 137, 0)
    assert (found["instrument"], found["eye"], found["filter"]) == ("NAVCAM", "left", None)
    assert found["local_solar_time"] == "11:23:54"
    assert found["camera"]["model"] == "CAHVOR"
    assert found["camera"]["field_of_view_deg"] == pytest.approx([45, 45], abs=1.5)  # Maki 2003
    assert found["size"]["masked_share"] == pytest.approx(0.0, abs=0.01)
    assert found["partner"]["product"] is None
    assert "RAD 2N292280938RADB100P0703L0C1 of the same exposure" in found["partner"]["why_none"]


def test_the_middle_of_the_image_has_the_commanded_direction(world, pair):
    """The rig's cameras look along the mast's x axis, but for the angles of their mounting."""
    found = inspect_file(pair[0])
    middle, mast = found["pointing"]["image_centre"], found["pointing"]["mast"]
    for frame in ("in_rover_deg", "in_site_deg"):
        azimuth, elevation = np.subtract(middle[frame], mast[frame])
        assert abs(azimuth) < 1.0
        assert abs(elevation) < 1.0
    exposure = world.exposure(world.shots[0], render_jobs(world)[0].eye)
    assert found["rover"]["in_site_m"] == pytest.approx(
        exposure.site_from_rover.translation_m.tolist(), abs=1e-4
    )
    assert found["sun"]["in_site_deg"][1] == pytest.approx(
        math.degrees(exposure.sun.elevation), abs=1e-3
    )


def test_transforming_into_the_site_applies_the_rovers_attitude(pair):
    """A level rover would look in the site where it looks in the rover, turned by its yaw."""
    found = inspect_file(pair[0])
    roll, pitch, yaw = found["rover"]["roll_pitch_yaw_deg"]
    (a, e), (a_site, e_site) = (
        found["pointing"]["mast"][frame] for frame in ("in_rover_deg", "in_site_deg")
    )
    tilt = math.hypot(roll, pitch)
    across = tilt / math.cos(math.radians(max(abs(e), abs(e_site))))
    assert abs((a_site - a - yaw + 180) % 360 - 180) <= across + 1e-6
    assert abs(e_site - e) <= tilt + 1e-6


def test_the_partner_in_the_folder_is_found_from_either_side(pair):
    left, right = pair
    assert inspect_file(left)["partner"] == {
        "product": right.stem.upper(),
        "file": str(right),
        "why_none": None,
    }
    assert inspect_file(right)["partner"]["product"] == left.stem.upper()
    right.unlink()
    assert "no right-eye partner" in inspect_file(left)["partner"]["why_none"]


def test_a_broken_neighbour_is_neither_a_partner_nor_a_fault(pair):
    left, right = pair
    right.write_bytes(b"no image")
    assert inspect_file(left)["partner"]["product"] is None


def test_the_share_of_masked_pixels_is_counted(pair):
    data = bytearray(pair[0].read_bytes())
    read = read_image(bytes(data), pair[0].name)
    lines, samples = read.pixels.shape
    data[-(lines // 4) * samples * 2 :] = bytes((lines // 4) * samples * 2)  # a lost quarter
    pair[0].write_bytes(bytes(data))
    assert inspect_file(pair[0])["size"]["masked_share"] == pytest.approx(0.25, abs=0.01)


def test_a_label_alone_is_described_without_its_pixels(shared_data):
    found = inspect_file(shared_data / "labels" / "1F490747543EFFCNY9P1214L0M1.lbl")
    assert found["camera"]["model"] == "CAHVORE"
    assert found["size"]["masked_share"] is None
    assert "mast" not in found["pointing"]  # Hazcams sit on the body
    assert found["camera"]["field_of_view_deg"] == pytest.approx([124, 124], abs=4)  # Maki 2003
    assert "masked" not in "\n".join(report_of(found))


def test_every_real_image_can_be_inspected(shared_data):
    files = sorted(shared_data.rglob("*.[iI][mM][gG]"))
    findings, faults = inspect_files(files)
    (fault,) = faults  # the one whose label was altered
    assert fault.startswith("1p216067135edn76pop2102l2m1.img: truncated")
    assert len(findings) == len(files) - 1
    for found in findings:
        assert json.loads(json.dumps(found)) == found
        assert found["product"] in report_of(found)[0]


def test_the_browse_image_is_the_stretched_image(pair, tmp_path):
    write_png(pair[0], tmp_path / "picture.png")
    png = cv2.imread(str(tmp_path / "picture.png"), cv2.IMREAD_UNCHANGED)
    read = read_image(pair[0].read_bytes(), pair[0].name)
    assert png.dtype == np.uint8
    assert png.shape == read.pixels.shape
    assert (png == 0).mean() == pytest.approx(0.01, abs=0.01)  # the lowest percent is black
    assert (png == 255).mean() == pytest.approx(0.01, abs=0.01)
    order = np.argsort(read.pixels.ravel(), kind="stable")
    assert (np.diff(png.ravel()[order].astype(int)) >= 0).all()


def test_the_angles_of_a_real_camera_rotate_its_axis(shared_data):
    """The third row of M(omega, phi, kappa) is -A (Di & Li 2004)."""
    found = inspect_file(shared_data / SPIRIT)
    omega, phi, _ = np.radians(found["camera"]["omega_phi_kappa_deg"])
    axis = [-np.sin(phi), np.sin(omega) * np.cos(phi), -np.cos(omega) * np.cos(phi)]
    camera = read_image((shared_data / SPIRIT).read_bytes(), SPIRIT).image.camera
    np.testing.assert_allclose(axis, camera.a / np.linalg.norm(camera.a), atol=1e-6)


def test_radiance_equals_that_of_the_label(shared_data):
    radiometric = SPIRIT.replace("effb100p0703l0m1", "radb100p0703l0c1")
    found = inspect_file(shared_data / radiometric)
    assert found["radiance"]["factor"] == pytest.approx(4.342e-6, rel=1e-3)
    assert "4.34237e-06 x pixel" in "\n".join(report_of(found))
    assert inspect_file(shared_data / SPIRIT)["radiance"] is None


XYZ_LABEL = """PDS_VERSION_ID = PDS3
RECORD_BYTES = 512
^IMAGE = 3
GROUP = DERIVED_IMAGE_PARMS
  DERIVED_IMAGE_TYPE = {kind}
  REFERENCE_COORD_SYSTEM_NAME = SITE_FRAME
  REFERENCE_COORD_SYSTEM_INDEX = 137
END_GROUP = DERIVED_IMAGE_PARMS
OBJECT = IMAGE
  LINES = 4
  LINE_SAMPLES = 5
  BANDS = {bands}
  BAND_STORAGE_TYPE = BAND_SEQUENTIAL
  SAMPLE_TYPE = IEEE_REAL
  SAMPLE_BITS = 32
END_OBJECT = IMAGE
END
"""


def derived_raster(file: Path, kind: str, values: np.ndarray) -> Path:
    label = XYZ_LABEL.format(kind=kind, bands=len(values)).encode()
    file.write_bytes(label.ljust(1024) + values.astype(">f4").tobytes())
    return file


def test_a_derived_raster_is_described(tmp_path, rng):
    points = rng.uniform(1.0, 2.0, (3, 4, 5)) + np.array([10.0, -20.0, 0.0])[:, None, None]
    points[:, 1, :] = 0.0
    found = inspect_file(derived_raster(tmp_path / "x.img", "XYZ_MAP", points))
    assert (found["raster"], found["frame"]) == ("xyz", "site[137]")
    assert found["size"] == {"samples": 5, "lines": 4, "masked_share": 0.25}
    assert [band["name"] for band in found["bands"]] == ["x", "y", "z"]
    measured = np.delete(points, 1, axis=1)
    for band, values in zip(found["bands"], measured, strict=True):
        assert band["unit"] == "m"
        assert band["range"] == pytest.approx([values.min(), values.max()], rel=1e-6)
    lines = report_of(found)
    assert lines[1].split() == ["holds", "xyz", "in", "the", "frame", "site[137]"]
    assert lines[3].split()[0] == "x"
    assert lines[3].endswith(" m")


def test_a_slope_has_no_frame_and_an_empty_one_is_reported(tmp_path):
    found = inspect_file(derived_raster(tmp_path / "s.img", "SLOPE_MAP", np.full((1, 4, 5), 7.5)))
    assert (found["raster"], found["frame"]) == ("slope", None)
    assert found["bands"] == [{"name": "slope", "unit": "degree", "range": [7.5, 7.5]}]
    empty = inspect_file(derived_raster(tmp_path / "e.img", "RANGE_MAP", np.zeros((1, 4, 5))))
    assert empty["bands"][0]["range"] is None
    assert "no value" in "\n".join(report_of(empty))


def test_a_truncated_raster_is_one_line(tmp_path):
    file = derived_raster(tmp_path / "x.img", "RANGE_MAP", np.ones((1, 4, 5)))
    file.write_bytes(file.read_bytes()[:-4])
    _, (fault,) = inspect_files([file])
    assert fault.startswith("x.img: truncated")


def test_both_eyes_are_linearised_onto_one_plane(pair, tmp_path):
    """Distant ground lies in the same line of both, but for the axis that JPL leaves askew."""
    for file in pair:
        write_linearised(file, tmp_path / file.with_suffix(".png").name)
    left, right = (
        cv2.imread(str(tmp_path / file.with_suffix(".png").name), cv2.IMREAD_UNCHANGED)
        for file in pair
    )
    assert left.shape == right.shape == (256, 256)
    images = [read_image(file.read_bytes(), file.name).image for file in pair]
    models = linearise_pair(images[0].camera, images[1].camera, 256, 256)
    far = models[0].c + 1e5 * models[0].rays(np.array([[60.0, 90.0], [200.0, 180.0]]))
    for image, model, shown in zip(images, models, (left, right), strict=True):
        original = read_image(
            (pair[0] if image is images[0] else pair[1]).read_bytes(), pair[0].name
        )
        grey, mask = linearise_image(original.pixels, original.mask, image.camera, model)
        np.testing.assert_array_equal(shown, stretch(grey, mask))
    seen = [model.project(far)[:, 1] for model in models]
    np.testing.assert_allclose(seen[0], seen[1], atol=0.01)


def test_an_image_without_a_partner_is_not_linearised(pair, shared_data, tmp_path):
    linear = shared_data / "mer_spirit_sol1900" / "2n295043924fflb1dnp1979l0m1.img"
    target = tmp_path / "x.png"
    with pytest.raises(InspectionError, match="needs the stereo partner beside it: no right-eye"):
        write_linearised(linear, target)
    pair[1].unlink()
    with pytest.raises(InspectionError, match="needs the stereo partner beside it: no right-eye"):
        write_linearised(pair[0], target)
    assert not target.exists()


def test_only_cahvor_cameras_are_linearised(pair, tmp_path):
    for file in pair:
        data = file.read_bytes()
        assert b"= CAHVOR" in data
        file.write_bytes(data.replace(b"= CAHVOR", b"= CAHV  "))
    with pytest.raises(InspectionError, match="is for CAHVOR cameras, not for CAHV"):
        write_linearised(pair[0], tmp_path / "x.png")


def test_an_unwritable_image_file_is_reported(pair, tmp_path):
    with pytest.raises(InspectionError, match=r"x.png cannot be written: No such file"):
        write_png(pair[0], tmp_path / "nowhere" / "x.png")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "n.img: the file is empty"),
        (b"just text", "n.img: not a PDS3 image"),
        (b"PDS_VERSION_ID = PDS3\nEND\n", "INSTRUMENT_HOST_ID is missing"),
    ],
)
def test_a_broken_file_is_one_line_with_its_name(tmp_path, data, message):
    file = tmp_path / "n.img"
    file.write_bytes(data)
    _, (line,) = inspect_files([file])
    assert message in line
    assert "n.img" in line
    assert "\n" not in line


def test_a_truncated_and_a_missing_file_are_named(pair, tmp_path):
    pair[0].write_bytes(pair[0].read_bytes()[:-1000])
    _, faults = inspect_files([pair[0], tmp_path / "gone.img", tmp_path])
    assert "truncated" in faults[0]
    assert faults[1].endswith("gone.img cannot be read: No such file or directory")
    assert faults[2].endswith("cannot be read: it is a folder; only regular files are read")


# On the command line


def test_the_command_prints_good_files_and_exits_with_one_if_any_is_broken(pair, tmp_path):
    broken = tmp_path / "broken.img"
    broken.write_text("nothing")
    result = CliRunner().invoke(app, ["inspect", str(pair[0]), str(broken), str(pair[1])])
    assert result.exit_code == 1
    assert "error broken.img: not a PDS3 image" in result.output
    assert pair[0].stem.upper() in result.output
    assert pair[1].stem.upper() in result.output


def test_the_command_writes_json_and_an_image(pair, tmp_path):
    png = tmp_path / "x.png"
    result = CliRunner().invoke(app, ["inspect", str(pair[0]), "--json", "--png", str(png)])
    assert result.exit_code == 0
    (found,) = json.loads(result.output)
    assert found["product"] == pair[0].stem.upper()
    assert png.read_bytes().startswith(b"\x89PNG")
    result = CliRunner().invoke(app, ["inspect", str(pair[0]), "--linearised", str(png)])
    assert result.exit_code == 0
    assert png.read_bytes().startswith(b"\x89PNG")


def test_one_output_image_for_several_inputs_is_refused(pair, tmp_path):
    result = CliRunner().invoke(app, ["inspect", *map(str, pair), "--png", str(tmp_path / "x.png")])
    assert result.exit_code == 1
    assert "writes one image, but 2 are named" in result.output.replace("\n", " ")


def test_an_image_with_metadata_and_labels_alone_are_inspected(shared_data, tmp_path):
    real = next(shared_data.rglob("NLF_0670_*-metadata.json"))
    message_ = json.loads(real.read_text()) | {"attitude": "(0.8,0.0,0.0,0.6)"}
    name = real.name.removesuffix("-metadata.json")
    label, png = tmp_path / f"{name}-metadata.json", tmp_path / f"{name}.png"
    label.write_text(json.dumps(message_))
    png.write_bytes(real.with_name(png.name).read_bytes())
    of_image, of_label = inspect_file(png), inspect_file(label)
    assert of_image["camera"] == of_label["camera"]
    assert of_image["size"]["masked_share"] < 0.01
    assert of_label["size"]["masked_share"] is None
    assert of_image["pointing"].keys() == {"image_centre"}  # metadata have no mast frame
    lines = report_of(of_image)
    assert lines[0] == message_["imageid"]
    png.with_name("alone.png").write_bytes(png.read_bytes())
    with pytest.raises(
        InspectionError, match=r"alone.png: an image without a label; alone-metadata.json"
    ):
        inspect_file(png.with_name("alone.png"))
    xml = Path(__file__).parents[2] / "archive" / "labels" / "navcam_of_perseverance.xml"
    assert inspect_file(xml)["camera"]["model"] == "CAHVORE"
