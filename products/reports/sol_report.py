"""The report of a sol as one HTML page: images, pairs, links, adjustment, layers, times.

Everything is read from the catalogue and from provenance, and nothing is computed again, so a
report can be made at any time. The page is self-contained.
"""

from __future__ import annotations

import base64
import json
import re
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from jinja2 import Environment, StrictUndefined

from solmap.products.catalogue.catalogue import ImageEntry, Outcome
from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import ProductError, ProductNotFoundError
from solmap.products.formats.documents.archives import read_matches
from solmap.products.model import Layer, ProductKind, ProductRef, mission_of
from solmap.products.store.provenance import SOFTWARE

THUMBNAIL_PX = 128
MOST_THUMBNAILS = 150
_STAGES = (ProductKind.MATCHES, ProductKind.PARALLAX)
_OF_NETWORK = (ProductKind.NETWORK, ProductKind.QUALITY, ProductKind.REPORT)


@dataclass(frozen=True, slots=True)
class SolPair:
    """A stereo pair that was matched."""

    left: str
    right: str
    points: int
    ref: ProductRef


@dataclass(frozen=True, slots=True)
class Timing:
    """Total time and memory of the products of a kind; the processor time of some is unknown."""

    kind: str
    count: int
    seconds: float
    cpu_s: float | None
    peak_rss_mb: float | None


@dataclass(frozen=True, slots=True)
class SolFacts:
    """Content of a sol's report."""

    mission: str
    origin: str
    """Origin of a map that is not tied to the lander; else empty."""
    sol: int
    images: list[ImageEntry]
    pairs: list[SolPair]
    links: list[dict[str, Any]]
    quality: dict[str, Any] | None
    report: ProductRef | None
    network: dict[str, Any] | None
    """Provenance of the network."""
    layers: list[Layer]
    outcomes: list[Outcome]
    timings: list[Timing]

    @property
    def unpaired(self) -> list[ImageEntry]:
        """Images without a partner."""
        return [image for image in self.images if image.partner is None]

    @property
    def failures(self) -> list[str]:
        """Failures of the sol."""
        failed = (outcome for outcome in self.outcomes if outcome.is_failure)
        return [f"{one.subject}: {note}" for one in failed for note in one.notes]

    @property
    def notes(self) -> list[str]:
        """Notes of the sol that are not failures."""
        well = (outcome for outcome in self.outcomes if not outcome.is_failure)
        return [f"{one.subject}: {note}" for one in well for note in one.notes]


def sol_facts(mission: str, sol: int, workspace: Workspace) -> SolFacts:
    """Collect the data of a sol from the store.

    Raises:
        ProductNotFoundError: it has no image of that sol.
    """
    catalogue = workspace.catalogue
    entry = catalogue.mission(mission)
    name = entry.mission
    images = catalogue.images(name, sol=sol)
    if not images:
        known = sorted({image.sol for image in catalogue.images(name)})
        few = ", ".join(map(str, known[-5:])) or "none"
        others = catalogue.maps_of(mission_of(name))
        there = [other for other in others if catalogue.images(other, sol=sol)]
        raise ProductNotFoundError(
            f"{name} has no image of sol {sol}; "
            + (f"{there[0]} has" if there else f"the last sols are {few}")
        )
    subject = f"{name.lower()}-sol{sol:04d}"
    adjusted = {kind: _latest(kind, subject, workspace) for kind in _OF_NETWORK}
    stops = {image.stop for image in images}
    layers = [layer for layer in catalogue.layers(name) if sol in layer.sols]
    made = list(_products(images, layers, workspace))
    made += [ref for ref in adjusted.values() if ref is not None]
    names = {image.id.lower() for image in images}
    return SolFacts(
        mission=name,
        origin=entry.landing.name if entry.landing.origin else "",
        sol=sol,
        images=images,
        pairs=list(_pairs(images, workspace)),
        links=_links(adjusted[ProductKind.NETWORK], stops, workspace),
        quality=_document(adjusted[ProductKind.QUALITY], workspace),
        report=adjusted[ProductKind.REPORT],
        network=_provenance(adjusted[ProductKind.NETWORK], workspace),
        layers=layers,
        outcomes=[one for one in catalogue.outcomes() if _concerns(one.subject, subject, names)],
        timings=timings(made, workspace),
    )


def timings(refs: list[ProductRef], workspace: Workspace) -> list[Timing]:
    """Time and memory of some products, kind by kind, the longest first."""
    found: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for ref in dict.fromkeys(refs):
        document = _provenance(ref, workspace)
        if document is not None:
            found[str(ref.kind)].append(document)
    rows = [_timing(kind, documents) for kind, documents in found.items()]
    return sorted(rows, key=lambda row: -row.seconds)


def thumbnail(image: ImageEntry, workspace: Workspace) -> bytes | None:
    """A small JPEG of an image, or None where its browse image is missing."""
    try:
        picture = cv2.imread(str(workspace.store.path(image.browse)), cv2.IMREAD_GRAYSCALE)
    except ProductError:
        return None
    if picture is None:
        return None
    scale = THUMBNAIL_PX / max(picture.shape)
    size = tuple(int(max(1, round(side * scale))) for side in picture.shape[::-1])
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    return bytes(cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 75])[1])


def _timing(kind: str, documents: list[dict[str, Any]]) -> Timing:
    known = [document for document in documents if "cpu_s" in document]
    whole = len(known) == len(documents)
    return Timing(
        kind,
        len(documents),
        float(np.sum([document["seconds"] for document in documents])),
        float(np.sum([document["cpu_s"] for document in known])) if whole else None,
        max((document["peak_rss_mb"] for document in known), default=None),
    )


def _products(
    images: list[ImageEntry], layers: list[Layer], workspace: Workspace
) -> Iterator[ProductRef]:
    for image in images:
        yield from (image.ref, image.browse)
    names = {image.id.lower() for image in images}
    for kind in _STAGES:
        yield from (ref for ref in workspace.catalogue.pointers(kind) if ref.scope.name in names)
    yield from (layer.ref for layer in layers)


def _pairs(images: list[ImageEntry], workspace: Workspace) -> Iterator[SolPair]:
    matches = {ref.scope.name: ref for ref in workspace.catalogue.pointers(ProductKind.MATCHES)}
    for image in images:
        ref = matches.get(image.id.lower())
        if ref is None or image.partner is None:
            continue
        try:
            _, points = read_matches(workspace.store.path(ref))
        except ProductError:
            continue
        yield SolPair(image.id, image.partner, len(points), ref)


def _links(
    network: ProductRef | None, stops: set[str], workspace: Workspace
) -> list[dict[str, Any]]:
    document = _document(network, workspace) or {}
    links = document.get("links", ())
    return [link for link in links if {link["earlier"], link["later"]} & stops]


def _latest(kind: ProductKind, subject: str, workspace: Workspace) -> ProductRef | None:
    digest = workspace.catalogue.latest(subject, kind)
    found = (ref for ref in workspace.catalogue.pointers(kind) if ref.scope.name == subject)
    return next(found, None) if digest else None


def _document(ref: ProductRef | None, workspace: Workspace) -> dict[str, Any] | None:
    if ref is None:
        return None
    try:
        return json.loads(workspace.store.path(ref).read_text(encoding="utf-8"))
    except ProductError:
        return None


def _provenance(ref: ProductRef | None, workspace: Workspace) -> dict[str, Any] | None:
    if ref is None:
        return None
    try:
        return workspace.store.provenance(ref)
    except ProductError:
        return None


def _concerns(subject: str, of_sol: str, names: set[str]) -> bool:
    """Outcomes of the sol, of its overall adjustment, and of its files."""
    plain = subject.rpartition("/")[2].lower().partition(".")[0]
    return subject in {of_sol, f"{of_sol}-overall"} or plain in names


def why_unpaired(images: list[ImageEntry]) -> list[tuple[str, int]]:
    """Reasons, with the number of images of each."""
    return Counter(image.unpaired_because or "reason unknown" for image in images).most_common()


MOST_ROWS = 300
"""Pairs or notes shown."""

PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{{ facts.mission }}, sol {{ facts.sol }}</title>
<style>
  :root { color-scheme: light dark; --ink: #222; --soft: #666; --line: #ddd; --bar: #4477aa;
          --bad: #b5442a; --paper: #fff; }
  @media (prefers-color-scheme: dark) { :root { --ink: #e6e6e6; --soft: #a8a8a8; --line: #444;
          --bar: #6ca0d8; --bad: #ff8c70; --paper: #181818; } }
  @media print { :root { --ink: #000; --soft: #444; --line: #bbb; --bar: #4477aa; --bad: #a03010;
          --paper: #fff; } .scroll { max-height: none !important; overflow: visible !important; }
          h2 { break-after: avoid; } tr, figure { break-inside: avoid; } }
  body { font: 15px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--paper);
         max-width: 64rem; margin: 2rem auto; padding: 0 1rem; }
  h1 { font-size: 1.5rem; margin-bottom: .2rem; }
  h2 { font-size: 1.1rem; margin-top: 2.2rem; border-bottom: 1px solid var(--line); }
  a { color: var(--bar); }
  table { border-collapse: collapse; font-size: .87rem; font-variant-numeric: tabular-nums; }
  th, td { padding: .2rem .8rem .2rem 0; text-align: left; vertical-align: top; }
  th { font-weight: 600; border-bottom: 1px solid var(--line); }
  td.n, th.n { text-align: right; }
  td.bar { width: 16rem; } td.bar div { background: var(--bar); height: .8em; margin-top: .35em; }
  .scroll { overflow: auto; max-height: 32rem; }
  .soft { color: var(--soft); font-size: .87rem; max-width: 48rem; }
  .bad { color: var(--bad); }
  .facts { display: flex; flex-wrap: wrap; gap: .4rem 1.8rem; margin: 1rem 0; }
  .facts b { display: block; font-size: 1.25rem; }
  .facts span { color: var(--soft); font-size: .8rem; }
  .thumbs { display: flex; flex-wrap: wrap; gap: .5rem; }
  .thumbs figure { margin: 0; width: 8.2rem; font-size: .62rem; line-height: 1.3;
                   overflow-wrap: anywhere; color: var(--soft); }
  .thumbs img { display: block; max-width: 100%; background: #000; }
  .picture { margin: 1rem 0; background: #fff; color: #222; padding: .5rem; }
  .picture img { max-width: 100%; height: auto; }
  pre { white-space: pre-wrap; overflow-wrap: anywhere; font-size: .75rem; }
</style>
</head>
<body>
{% macro n(value, digits=2) %}{{ "–" if value is none else ("%." ~ digits ~ "f")|format(value) }}
{%- endmacro %}
<h1>{{ facts.mission }}, sol {{ facts.sol }}</h1>
{% if facts.origin %}<p>{{ facts.origin }}</p>{% endif %}
<div class="soft">{{ software }}, science version {{ science or "–" }}, adjusted {{ made_at or
  "not yet" }}</div>
<div class="facts">
  <div><b>{{ facts.images|length }}</b><span>images</span></div>
  <div><b>{{ facts.pairs|length }}</b><span>matched pairs</span></div>
  <div><b>{{ facts.unpaired|length }}</b><span>unpaired images</span></div>
  <div><b>{{ facts.links|selectattr("linked")|list|length }} of {{ facts.links|length }}</b>
    <span>links to other stops</span></div>
  <div><b>{{ facts.layers|length }}</b><span>layers</span></div>
  <div><b{% if facts.failures %} class="bad"{% endif %}>{{ facts.failures|length }}</b>
    <span>failures</span></div>
</div>

<h2>Failures and findings</h2>
{% if not facts.failures and not facts.notes %}<p>None.</p>{% endif %}
<ul>{% for line in facts.failures[:most] %}<li class="bad">{{ line }}</li>{% endfor %}
{% for line in facts.notes[:most] %}<li>{{ line }}</li>{% endfor %}</ul>

<h2>Images</h2>
{% if unpaired %}<table><tr><th>unpaired because</th><th class="n">images</th></tr>
{% for reason, count in unpaired %}<tr><td>{{ reason }}</td><td class="n">{{ count }}</td></tr>
{% endfor %}</table>{% endif %}
<div class="thumbs">{% for image, picture in thumbnails %}
<figure>{% if picture %}<img alt="{{ image.id }}" src="{{ picture }}">{% endif %}
{{ image.id }} {{ image.eye }}</figure>{% endfor %}</div>
{% if facts.images|length > thumbnails|length %}
<p class="soft">and {{ facts.images|length - thumbnails|length }} more</p>{% endif %}

<h2>Matches</h2>
<div class="scroll"><table>
<tr><th>left</th><th>right</th><th class="n">points</th><th></th></tr>
{% for pair in facts.pairs[:most] %}<tr><td>{{ pair.left }}</td><td>{{ pair.right }}</td>
<td class="n">{{ pair.points }}</td>
<td class="bar"><div style="width: {{ (100 * pair.points / most_points)|round(1) }}%"></div></td>
</tr>{% endfor %}
</table></div>

<h2>Links between stops</h2>
{% if facts.links %}<div class="scroll"><table>
<tr><th>earlier</th><th>later</th><th></th><th>why</th></tr>
{% for link in facts.links %}<tr><td>{{ link.earlier }}</td><td>{{ link.later }}</td>
<td{% if not link.linked %} class="bad"{% endif %}>{{ "linked" if link.linked else "not linked" }}
</td><td>{{ link.reason }}</td></tr>{% endfor %}
</table></div>{% else %}<p>None: it is the first stop, or nothing is known of links.</p>{% endif %}

<h2>Adjustment</h2>
{% if adjustment %}
<p>{{ adjustment.summary }}</p>
<table><tr><th>ties</th><th class="n">compared</th><th class="n">px before</th>
<th class="n">px after</th><th class="n">m before</th><th class="n">m after</th></tr>
{% for kind, before in adjustment.before.items() %}{% set after = adjustment.after.get(kind, {}) %}
<tr><td>{{ kind }}</td><td class="n">{{ before.comparisons }}</td>
<td class="n">{{ n(before.mean_2d_px, 3) }}</td><td class="n">{{ n(after.get("mean_2d_px"), 3) }}
</td><td class="n">{{ n(before.mean_3d_m, 3) }}</td>
<td class="n">{{ n(after.get("mean_3d_m"), 3) }}</td></tr>{% endfor %}</table>
<h3>Weak parts</h3>
{% if weaknesses %}<ul>{% for weak in weaknesses[:most] %}<li>{{ weak }}</li>{% endfor %}</ul>
{% else %}<p>None.</p>{% endif %}
{% for figure in figures %}<figure class="picture">{{ figure|safe }}</figure>{% endfor %}
{% if report %}<p class="soft">In full: the quality report of {{ report }}.</p>{% endif %}
{% else %}<p>There is none: no stop of the sol could be adjusted.</p>{% endif %}

<h2>Layers</h2>
<div class="scroll"><table>
<tr><th>layer</th><th>of</th><th class="n">cell, m</th><th>made</th><th>digest</th></tr>
{% for layer in facts.layers %}<tr>
<td>{{ layer.title }}</td><td>{{ layer.ref.scope.name }}</td>
<td class="n">{{ n(layer.cell_m, 3) }}</td><td>{{ layer.made_at }}</td>
<td><a href="{{ base }}/download/{{ layer.ref.scope.name }}/{{ layer.ref.kind }}/{{
  layer.ref.digest }}">{{ layer.ref.digest }}</a></td></tr>{% endfor %}
</table></div>

<h2>Time and memory</h2>
<table><tr><th>products</th><th class="n">how many</th><th class="n">seconds by the clock</th>
<th></th><th class="n">of the processor</th><th class="n">peak memory, MB</th></tr>
{% for row in facts.timings %}<tr><td>{{ row.kind }}</td><td class="n">{{ row.count }}</td>
<td class="n">{{ n(row.seconds, 1) }}</td>
<td class="bar"><div style="width: {{ (100 * row.seconds / longest)|round(1) }}%"></div></td>
<td class="n">{{ n(row.cpu_s, 1) }}</td><td class="n">{{ n(row.peak_rss_mb, 0) }}</td></tr>
{% endfor %}</table>
<p class="soft">Sums over the products of a kind, from their provenance. Stages run beside
each other: the sum by the clock is more than the sol took. Seconds of the processor are those of
the thread that made a product; memory is the most that its whole process had held by then.</p>

<h2>Provenance</h2>
<p>{{ network or "No network." }}</p>
{% if recipe %}<details><summary>Recipe of the network</summary><pre>{{ recipe }}</pre></details>
{% endif %}
</body>
</html>
"""


def sol_report(mission: str, sol: int, workspace: Workspace, base: str = "") -> str:
    """The page of a sol; addresses of layers begin with `base`, the address of the map's server.

    Raises:
        ProductNotFoundError: the store has no image of that sol.
    """
    facts = sol_facts(mission, sol, workspace)
    made = facts.network or {}
    recipe = made.get("recipe", {})
    quality = facts.quality or {}
    page = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    return page.from_string(PAGE).render(
        facts=facts,
        base=base.rstrip("/"),
        software=made.get("software", SOFTWARE),
        science=recipe.get("science"),
        made_at=made.get("made_at"),
        network=" ".join(f"{name} {made[name]}," for name in ("made_at", "sha256") if name in made),
        recipe=json.dumps(recipe, indent=1)[:200_000] if recipe else "",
        unpaired=why_unpaired(facts.unpaired),
        thumbnails=[
            (image, _inline(thumbnail(image, workspace)))
            for image in facts.images[:MOST_THUMBNAILS]
        ],
        most=MOST_ROWS,
        most_points=max((pair.points for pair in facts.pairs), default=1) or 1,
        longest=max((row.seconds for row in facts.timings), default=1.0) or 1.0,
        adjustment=quality.get("adjustment"),
        weaknesses=[_weak(one) for one in quality.get("quality", {}).get("weaknesses", ())],
        figures=_figures(facts, workspace),
        report=facts.report.scope.name if facts.report else None,
    )


def _inline(picture: bytes | None) -> str | None:
    return f"data:image/jpeg;base64,{base64.b64encode(picture).decode()}" if picture else None


def _weak(one: Any) -> str:  # noqa: ANN401 - a row of the quality document
    return " ".join(str(value) for value in one.values()) if isinstance(one, dict) else str(one)


def _figures(facts: SolFacts, workspace: Workspace) -> list[str]:
    """The figures of the quality report, which are embedded in its page."""
    if facts.report is None:
        return []
    try:
        page = workspace.store.path(facts.report).read_text(encoding="utf-8")
    except ProductError:
        return []
    return re.findall(r'<img [^>]*src="data:image/svg\+xml;base64,[A-Za-z0-9+/=]+"[^>]*>', page)
