import numpy as np
import pytest

from solmap.config.radiometry import load_radiometry
from solmap.config.records import ConfigError
from solmap.config.settings import Settings
from solmap.photogrammetry.archive.images.radiometry import RadialVignetting

COUNTS = list(range(0, 4096, 16))
TABLE = f"counts = {COUNTS}"


def written(folder, text):
    (folder / "rover.toml").write_text(f'hosts = ["ROVER"]\n{text}')
    return folder


LABEL = """PDS_VERSION_ID = PDS3\nRECORD_BYTES = 512\n^IMAGE = 2\nOBJECT = IMAGE\nLINES = 40
LINE_SAMPLES = 60\nSAMPLE_TYPE = MSB_INTEGER\nSAMPLE_BITS = 16\nEND_OBJECT = IMAGE\nEND\n"""


def flat_image(middle, edge):
    """An image of an even source whose first column is darker."""
    pixels = np.full((40, 60), middle, dtype=">i2")
    pixels[:, 0] = edge
    return LABEL.encode().ljust(512) + pixels.tobytes()


def test_the_shipped_radiometry_changes_no_pixel():
    shipped = load_radiometry(Settings().instruments)
    assert set(shipped) == {"MER1", "MER2"}
    assert all(radiometry.changes_nothing for radiometry in shipped.values())


def test_another_folder_can_be_named(tmp_path, monkeypatch):
    monkeypatch.setenv("SOLMAP_INSTRUMENTS", str(written(tmp_path, "")))
    assert set(load_radiometry(Settings().instruments)) == {"ROVER"}


def test_tables_and_models_are_read(tmp_path):
    folder = written(
        tmp_path,
        f"[companding]\napproximate = true\n[companding.tables.LUT3]\n{TABLE}\n"
        'source = "a test"\n[vignetting.NAVCAM_LEFT]\nk1 = -0.2\ncentre = [500, 510.5]\n',
    )
    radiometry = load_radiometry(folder)["ROVER"]
    table = radiometry.companding.table("LUT3")
    np.testing.assert_array_equal(table.counts, COUNTS)
    assert not table.is_approximation
    assert radiometry.companding.table("LUT1").is_approximation
    model = radiometry.flat_fields["NAVCAM_LEFT"]
    assert model == RadialVignetting(k1=-0.2, centre=(500.0, 510.5))


def test_an_image_of_a_uniform_source_is_a_flat_field(tmp_path):
    (tmp_path / "calib").mkdir()
    (tmp_path / "calib" / "flat.img").write_bytes(flat_image(middle=2000, edge=1500))
    written(tmp_path, '[flat_fields]\nNAVCAM_LEFT = "calib/flat.img"')
    flat = load_radiometry(tmp_path)["ROVER"].flat_fields["NAVCAM_LEFT"]
    assert flat.shape == (40, 60)
    np.testing.assert_array_equal(flat[:, 0], 0.75)
    assert (flat[:, 1:] == 1).all()


@pytest.mark.parametrize(
    ("image", "message"),
    [(None, "flat.img"), (b"text", "NAVCAM_LEFT: flat.img: not a PDS3"), (0, "without light")],
)
def test_an_invalid_flat_field_is_refused(tmp_path, image, message):
    if image is not None:
        data = image if isinstance(image, bytes) else flat_image(2000, edge=image)
        (tmp_path / "flat.img").write_bytes(data)
    written(tmp_path, '[flat_fields]\nNAVCAM_LEFT = "flat.img"')
    with pytest.raises(ConfigError, match=message):
        load_radiometry(tmp_path)


def test_a_missing_folder_and_a_spacecraft_in_two_files_are_refused(tmp_path):
    with pytest.raises(ConfigError, match="should contain a TOML file for each mission"):
        load_radiometry(tmp_path / "nowhere")
    written(tmp_path, "")
    (tmp_path / "twice.toml").write_text('hosts = ["ROVER"]')
    with pytest.raises(ConfigError, match="ROVER is in the hosts of another file"):
        load_radiometry(tmp_path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a = [", "rover.toml"),
        ("lut = 1", "no setting 'lut'"),
        ("companding = 3", "companding should be a table"),
        ("[vignetting.NAVCAM_LEFT]\nk1 = 0.0\n[flat_fields]\nNAVCAM_LEFT = 'x'", "rover.toml"),
        ("[companding]\nguess = true", "companding has approximate"),
        ("[companding.tables.LUT3]\ncounts = [1]", "has counts and source, not"),
        (
            "[companding.tables.LUT3]\ncounts = [1]\nsource = 'x'",
            "LUT3: .* expected 256 non-decreasing counts",
        ),
        ("[companding.tables.LUT3]\ncounts = ['x']\nsource = 'x'", "rover.toml: LUT3"),
        ("[vignetting.NAVCAM_LEFT]\nk4 = 1.0", "no setting 'k4'"),
    ],
)
def test_a_broken_file_is_refused_with_its_key(tmp_path, text, message):
    with pytest.raises(ConfigError, match=message):
        load_radiometry(written(tmp_path, text))
