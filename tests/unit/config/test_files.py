"""Wrong values in the TOML files that users may bring end in one line with file and key."""

import pytest

from solmap.config.archive import load_archive
from solmap.config.landing import landing_site
from solmap.config.records import ConfigError

SITE = """
[MER2]
name = "CMS"
longitude = 175.0
latitude = -14.0
radius_m = 3393000.0
source = "me"
"""
ARCHIVE = """
[missions.MER2]
title = "Spirit"
base_urls = ["https://example.org/a"]
volumes = {navcam = "mer2no_0xxx"}
"""


def refusal(read, file, text):
    file.write_text(text)
    with pytest.raises(ConfigError) as refused:
        read()
    assert "\n" not in str(refused.value)
    assert file.name in str(refused.value)
    return str(refused.value)


@pytest.mark.parametrize(
    ("wrong", "by", "message"),
    [
        ("longitude = 175.0", "longitude = nan", "longitude takes a finite number"),
        ("longitude = 175.0", "longitude = 1000", "not on a globe"),
        ("radius_m = 3393000.0", "radius_m = -1", "there is no ground"),
        ("radius_m = 3393000.0", "radius_m = 'far'", "radius_m takes float"),
        ('name = "CMS"', "name = 3", "name takes str"),
        ('source = "me"', "", "source"),
        ("latitude", "latitud", "did you mean latitude?"),
        ("[MER2]", "MER1 = 3\n[MER2]", "a table"),
    ],
)
def test_landing_sites(wrong, by, message, tmp_path):
    file = tmp_path / "sites.toml"
    text = SITE.replace(wrong, by)
    assert message in refusal(lambda: landing_site("MER2", file), file, text)


@pytest.mark.parametrize(
    ("wrong", "by", "message"),
    [
        ('"https://example.org/a"', '"file:///etc/passwd"', "http or https"),
        ('"https://example.org/a"', '"https://[::1"', "missions.MER2"),
        ('"https://example.org/a"', '"https://example.org:99999"', "missions.MER2"),
        ('["https://example.org/a"]', "[]", "at least one address"),
        ('["https://example.org/a"]', '"https://example.org/a"', "is a list"),
        ('{navcam = "mer2no_0xxx"}', "3", "volumes is a table"),
        ('"mer2no_0xxx"', "3", "volumes.navcam takes str"),
        ("[missions.MER2]", "transfer = 3\n[missions.MER2]", "transfer is a table"),
        ("[missions.MER2]", "redirect_hosts = 'x'\n[missions.MER2]", "redirect_hosts is a list"),
        ("[missions.MER2]", "[missions]\nMER1 = 3\n[missions.MER2]", "missions.MER1"),
    ],
)
def test_archives(wrong, by, message, tmp_path):
    file = tmp_path / "archive.toml"
    assert message in refusal(lambda: load_archive(file), file, ARCHIVE.replace(wrong, by))
