"""Rows of positions come from the documents of a network, whichever product holds a stop."""

import json
from types import SimpleNamespace

import pytest

from solmap.flows.cli import tables
from solmap.photogrammetry.imagery import StopId
from solmap.products.model import ProductKind, ProductRef, Scope, ScopeLevel


def document(stops, holders=None):
    """A network or a part of one: site, drive and northing of its stops."""
    pose = {"rotation": [], "translation_m": [0.0, 0.0, 0.0], "quaternion": [1.0, 0.0, 0.0, 0.0]}
    names = [{"mission": "MER2", "site": site, "drive": drive} for site, drive, _ in stops]
    variances = [[float(row == col) * row for col in range(6)] for row in range(6)]
    return {
        "mission": "MER2",
        "stops": [name | {"sols": [155], "telemetry": pose} for name in names],
        "network": {
            "stops": [
                name
                | {"lsl_from_rover": pose | {"translation_m": [north, 0.0, 0.0]}}
                | {"covariance": variances, "held": False, "held_by": "ties"}
                for name, (_, _, north) in zip(names, stops, strict=True)
            ]
        },
        "holders": holders or {},
    }


def test_stops_of_other_products_are_listed_from_those(tmp_path, monkeypatch):
    network, left = (
        ProductRef(kind, Scope(ScopeLevel.SOL, "mer2-sol0156"), digest)
        for kind, digest in ((ProductKind.NETWORK, "a"), (ProductKind.MARGINALISED_STOP, "b"))
    )
    holders = {str(StopId("MER2", 9, 8)): left.text}
    documents = {
        network: document([(10, 12, 4.0), (10, 0, 3.0)], holders),
        left: document([(9, 8, 1.0), (9, 0, 2.0)]),  # 9/0 is held by nothing any more
    }
    for ref, content in documents.items():
        (tmp_path / ref.digest).write_text(json.dumps(content))
    store = SimpleNamespace(path=lambda ref: tmp_path / ref.digest)
    monkeypatch.setattr(tables, "latest_networks", lambda _: [network])
    rows = tables.position_rows(SimpleNamespace(store=store))
    assert [(row["stop"], row["adjusted_ned_m"][0]) for row in rows] == [
        (str(StopId("MER2", 9, 8)), 1.0),
        (str(StopId("MER2", 10, 0)), 3.0),
        (str(StopId("MER2", 10, 12)), 4.0),
    ]
    assert {row["map"] for row in rows} == {"MER2"}
    assert rows[0]["sigma_ned_m"] == pytest.approx([3**0.5, 2.0, 5**0.5])
