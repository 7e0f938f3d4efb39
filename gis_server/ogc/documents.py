"""Links between the documents of OGC API, and its pages for people.

Pages are plain tables that need nothing from elsewhere.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from html import escape
from typing import Any

from solmap.gis_server.ogc.formats import FeaturePage
from solmap.products.features.collections import CollectionDefinition

Link = dict[str, str]
JSON, GEOJSON, HTML = "application/json", "application/geo+json", "text/html"
_FRAME = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title>
<meta name="viewport" content="width=device-width"><link rel="icon" href="data:,">
<style>:root{{color-scheme:light dark}}body{{font:15px/1.45 system-ui,sans-serif;margin:2rem auto;
max-width:80rem;padding:0 1rem}}table{{border-collapse:collapse;display:block;overflow-x:auto}}
td,th{{border:1px solid #8886;padding:.2rem .5rem;text-align:left;font-size:13px}}</style></head>
<body><h1>{title}</h1>
{body}
</body></html>
"""


def link(rel: str, href: str, media_type: str, title: str = "") -> Link:
    """A link as OGC API has it."""
    named = {"title": title} if title else {}
    return {"rel": rel, "href": href, "type": media_type, **named}


def page(title: str, *parts: str) -> str:
    """A page; its parts are HTML already."""
    return _FRAME.format(title=escape(title), body="\n".join(parts))


def paragraph(text: str) -> str:
    """A paragraph of plain text."""
    return f"<p>{escape(text)}</p>"


def link_list(links: Iterable[Link]) -> str:
    """Links by what they are to the page."""
    rows = "".join(
        f'<li>{escape(one["rel"].rsplit("/", 1)[-1])}: <a href="{escape(one["href"])}">'
        f"{escape(one.get('title') or one['href'])}</a> <small>{escape(one['type'])}</small></li>"
        for one in links
    )
    return f"<ul>{rows}</ul>"


def table(rows: Iterable[Mapping[str, Any]]) -> str:
    """Records as a table, a column for each name."""
    listed = list(rows)
    names = list(dict.fromkeys(name for row in listed for name in row))
    head = "".join(f'<th scope="col">{escape(name)}</th>' for name in names)
    body = "".join(
        "<tr>" + "".join(f"<td>{_cell(row.get(name))}</td>" for name in names) + "</tr>"
        for row in listed
    )
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _cell(value: Any) -> str:  # noqa: ANN401 - a property
    if value is None:
        return ""
    text = json.dumps(value) if isinstance(value, list | dict | bool) else str(value)
    if text.startswith(("http://", "https://")):
        return f'<a href="{escape(text)}">{escape(text)}</a>'
    return escape(text)


def items_page(
    known: CollectionDefinition,
    features: FeaturePage,
    links: Iterable[Link],
    counts: Mapping[str, int],
) -> str:
    """A page of features as a table."""
    rows = (
        {"id": one.name, **row, "place": "" if shape is None else shape.wkt[:80]}
        for one, row, shape in zip(
            features.features, features.rows(), features.shapes(), strict=True
        )
    )
    count = f"{counts['numberReturned']} of {counts['numberMatched']} features"
    return page(
        known.title, paragraph(known.description), paragraph(count), link_list(links), table(rows)
    )


def feature_page(known: CollectionDefinition, features: FeaturePage, links: Iterable[Link]) -> str:
    """One feature, a row for each property."""
    (one,), (row,), (shape,) = features.features, features.rows(), features.shapes()
    place = {"name": "place", "value": "" if shape is None else shape.wkt}
    values = [{"name": name, "value": value} for name, value in row.items()]
    return page(f"{known.title}: {one.name}", link_list(links), table([*values, place]))
