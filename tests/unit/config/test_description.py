"""The configuration as people read it: effective values, units, reasons, and the docs page."""

import tomllib
from dataclasses import replace
from pathlib import Path

import pytest

from solmap.config.description import (
    Parameter,
    configuration_page,
    pipeline_toml,
    reasons,
    tables_of,
    toml_value,
)
from solmap.config.pipeline import PipelineConfig, load_pipeline
from solmap.photogrammetry.adjustment.model.params import AdjustmentMode
from solmap.photogrammetry.terrain.dtm.stop_dtm import FarDtmParams

DOCS = Path(__file__).parents[3] / "docs" / "reference" / "configuration.md"


def written(config, tmp_path):
    file = tmp_path / "shown.toml"
    file.write_text(pipeline_toml(config))
    return load_pipeline(str(file))


@pytest.mark.parametrize("name", ["default", "quicklook"])
def test_the_shown_configuration_gives_the_same_pipeline(name, tmp_path):
    assert written(load_pipeline(name), tmp_path) == load_pipeline(name)


def test_values_that_differ_from_the_defaults_are_shown(tmp_path):
    changed = PipelineConfig(
        adjustment_mode=AdjustmentMode.OVERALL,
        insolation=replace(PipelineConfig().insolation, ls_deg=(90.0, 270.0)),
        contour=replace(PipelineConfig().contour, interval_m=0.25),
    )
    assert written(changed, tmp_path) == changed


def test_every_table_and_parameter_is_shown():
    tables = tomllib.loads(pipeline_toml(PipelineConfig()))
    for table in tables_of(PipelineConfig()):
        found = tables
        for part in table.key.split(".") if table.key else ():
            found = found.get(part, {})
        assert {one.name for one in table.parameters if one.value is not None} <= found.keys()


def test_units_and_reasons_are_beside_the_values():
    text = pipeline_toml(PipelineConfig())
    assert "# Side of the correlation window, odd.\nwindow_px = 15  # pixel\n" in text
    assert "# interval_m =  # not set; metre\n" in text
    assert 'adjustment_mode = "sequential"  # stepwise | sequential | overall\n' in text


def test_units_are_read_from_names():
    assert Parameter("cell_m", 1.0, "").unit == "metre"
    assert Parameter("points_per_m", 1.0, "").unit == "per metre"
    assert Parameter("count", 1, "").unit == Parameter("m", 1, "").unit == ""


def test_reasons_of_base_classes_are_included():
    assert {"cell_m", "method"} <= reasons(FarDtmParams).keys()
    assert reasons(FarDtmParams)["cell_m"].startswith("Four Navcam pixels at 200 m")


def test_values_are_written_in_toml_syntax():
    for value in (True, 1, 1e-08, float("inf"), 'a "b" \u00e9\n', [0.5, 99.5]):
        assert tomllib.loads(f"x = {toml_value(value)}")["x"] == value


def test_the_page_of_the_documentation_is_current():
    reported = "run `solmap config docs --out docs/reference/configuration.md`"
    assert DOCS.read_text(encoding="utf-8") == configuration_page(), reported
