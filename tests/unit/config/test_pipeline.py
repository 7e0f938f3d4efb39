"""Shipped pipelines, and what a user's file may contain."""

from dataclasses import replace

import pytest

from solmap.config.pipeline import PipelineConfig, load_pipeline
from solmap.config.records import ConfigError
from solmap.config.settings import PIPELINES
from solmap.photogrammetry.matching.conjugates import ConjugateParams
from solmap.photogrammetry.terrain.dtm.stop_dtm import FarDtmParams


def test_every_shipped_pipeline_can_be_loaded():
    names = [path.stem for path in PIPELINES.glob("*.toml")]
    assert {"default", "quicklook"} <= set(names)
    for name in names:
        assert isinstance(load_pipeline(name), PipelineConfig)


def test_far_ground_is_mapped_unless_a_pipeline_is_for_a_first_look(tmp_path):
    assert load_pipeline("default").wide.enabled
    assert not load_pipeline("quicklook").wide.enabled
    file = tmp_path / "far.toml"
    file.write_text(
        "[wide]\nenabled = true\n[wide.dtm]\ncell_m = 1.28\n"
        "[wide.matching.limits]\nleast_base_m = 5.0\n"
    )
    wide = load_pipeline(str(file)).wide
    assert wide.enabled
    assert wide.dtm == FarDtmParams(cell_m=1.28)  # the others are those of far ground
    assert wide.matching.limits.least_base_m == 5.0


def test_seasons_and_limits_of_a_rover_can_be_set(tmp_path):
    file = tmp_path / "sun.toml"
    file.write_text(
        "[insolation]\nls_deg = [90, 0.0]\n[havens]\nleast_gain = 1.08\n"
        "[hazard]\nsteepest_deg = 15\n[viewshed]\ntarget_height_m = 0.5\n"
    )
    config = load_pipeline(str(file))
    assert config.insolation.ls_deg == (90.0, 0.0)
    assert (config.havens.least_gain, config.hazard.steepest_deg) == (1.08, 15.0)
    assert config.viewshed.target_height_m == 0.5
    file.write_text("[hazard]\nsteepest_deg = 0\n")
    with pytest.raises(ConfigError, match="steepest_deg should be more than 0"):
        load_pipeline(str(file))


def test_an_unknown_setting_of_far_ground_is_named(tmp_path):
    file = tmp_path / "far.toml"
    file.write_text("[wide]\nradius_m = 500.0\n")
    with pytest.raises(ConfigError, match=r"far\.toml\.wide has no setting 'radius_m'"):
        load_pipeline(str(file))


def test_a_nested_table_keeps_its_other_defaults(tmp_path):
    path = tmp_path / "few.toml"
    path.write_text("[mono.conjugates]\nthreshold = 0.8\n")
    default = load_pipeline("default").mono.conjugates
    assert default != ConjugateParams()
    assert load_pipeline(str(path)).mono.conjugates == replace(default, threshold=0.8)
