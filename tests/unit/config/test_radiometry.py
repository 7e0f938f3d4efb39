import numpy as np
import pytest

from config.errors import ConfigError
from config.radiometry import radiometry_of
from photogrammetry.pds3.vignetting import RadialVignetting

COUNTS = list(range(0, 4096, 16))


def written(folder, text):
    (folder / "rover.toml").write_text(f'hosts = ["ROVER"]\n{text}')
    return folder


def test_what_is_shipped_changes_no_pixel():
    for mission in ("MER1", "MER2", "MSL", "ROVER"):
        radiometry = radiometry_of(mission)
        assert radiometry.companding.table("LUT3") is None
        assert radiometry.flat_fields == {}


def test_tables_and_models_are_read(tmp_path):
    folder = written(
        tmp_path,
        f"[companding]\napproximate = true\n[companding.tables.LUT3]\ncounts = {COUNTS}\n"
        'source = "a test"\n[vignetting.NAVCAM_LEFT]\nk1 = -0.2\ncentre = [500, 510.5]\n',
    )
    radiometry = radiometry_of("ROVER", folder)
    table = radiometry.companding.table("LUT3")
    np.testing.assert_array_equal(table.counts, COUNTS)
    assert not table.is_approximation
    assert radiometry.companding.table("LUT1").is_approximation
    model = radiometry.flat_fields["NAVCAM_LEFT"]
    assert model == RadialVignetting(k1=-0.2, centre=(500.0, 510.5))
    assert radiometry_of("OTHER", folder).flat_fields == {}


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("a = [", "rover.toml"),
        ("lut = 1", "no setting 'lut'"),
        ("[companding]\nguess = true", "companding has approximate"),
        ("[companding.tables.LUT3]\ncounts = [1]", "has counts and source, not"),
        ("[companding.tables.LUT3]\ncounts = [1]\nsource = 'x'", "LUT3: .* expected 256 counts"),
        ("[companding.tables.LUT3]\ncounts = ['x']\nsource = 'x'", "rover.toml: LUT3"),
        ("[vignetting.NAVCAM_LEFT]\nk4 = 1.0", "no setting 'k4'"),
    ],
)
def test_a_broken_file_is_refused_with_its_key(tmp_path, text, complaint):
    with pytest.raises(ConfigError, match=complaint):
        radiometry_of("ROVER", written(tmp_path, text))
