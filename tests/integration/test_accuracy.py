"""`make accuracy` on thumbnails: figures are written once, and again when something has changed."""

import json

import pytest

from tests.support import accuracy

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]


def test_a_small_world_is_run_once_and_listed_on_the_scorecard(tmp_path, monkeypatch):
    requested = ["--level", "quick", "--out", str(tmp_path)]
    assert accuracy.main(requested) == 0
    out = tmp_path / "quick"
    card = json.loads((out / "scorecard.json").read_text())
    (world,) = card["worlds"]
    assert world["world"] == "thumbnails"
    _, stop = world["stops"]
    assert 0 < stop["nees"] < 10
    assert stop["adjusted_error_m"] < stop["telemetry_error_m"]
    assert [link["linked"] for link in world["links"]] == [True]
    assert world["cpu_s_a_stop"] > 0
    assert "| thumbnails | site0010-drive" in (out / "scorecard.md").read_text()
    assert not list((out / "stores").iterdir())

    made = (out / "thumbnails.json").stat().st_mtime_ns
    assert accuracy.main(requested) == 0
    assert (out / "thumbnails.json").stat().st_mtime_ns == made
    monkeypatch.setattr(accuracy, "code_digest", lambda: "other code")
    assert accuracy.main([*requested, "--only", "no such world"]) == 0
    assert "| thumbnails (other code) |" in (out / "scorecard.md").read_text()
    monkeypatch.setattr(accuracy, "_run", lambda *_: (1.0, "it was run again"))
    assert accuracy.main(requested) == 1
    assert "it was run again" in (out / "scorecard.md").read_text()
