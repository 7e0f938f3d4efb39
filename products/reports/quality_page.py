"""The quality report as one self-contained page."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from typing import Any

from jinja2 import Environment, StrictUndefined

from solmap.photogrammetry.imagery import StopId

PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{{ title }}</title>
<style>
  body { font: 15px/1.5 system-ui, sans-serif; color: #222; max-width: 62rem; margin: 2rem auto;
         padding: 0 1rem; }
  h1 { font-size: 1.5rem; margin-bottom: .2rem; }
  h2 { font-size: 1.1rem; margin-top: 2.2rem; border-bottom: 1px solid #ddd; }
  table { border-collapse: collapse; font-size: .87rem; font-variant-numeric: tabular-nums; }
  th, td { padding: .2rem .7rem .2rem 0; text-align: left; vertical-align: top; }
  th { font-weight: 600; border-bottom: 1px solid #bbb; }
  td.n, th.n { text-align: right; }
  td.id { white-space: nowrap; }
  .scroll { overflow-x: auto; max-height: 32rem; }
  .note { color: #666; font-size: .87rem; max-width: 46rem; }
  .weak li { margin: .15rem 0; } .weak b { color: #b5442a; }
  figure { margin: 1rem 0; } img { max-width: 100%; height: auto; }
  .facts { display: flex; flex-wrap: wrap; gap: .4rem 1.8rem; margin: 1rem 0; }
  .facts b { display: block; font-size: 1.25rem; } .facts span { color: #666; font-size: .8rem; }
</style>
</head>
<body>
{% macro n(value, digits=3) %}{{ "–" if value is none else ("%." ~ digits ~ "f")|format(value) }}
{%- endmacro %}
{% macro three(values, digits) %}
{% for value in values or (none, none, none) %}<td class="n">{{ n(value, digits) }}</td>{% endfor %}
{% endmacro %}
<h1>{{ title }}</h1>
<div>{{ adjustment.name }}{% if adjustment.message %} ({{ adjustment.message }}){% endif %}</div>
<div class="facts">
  <div><b>{{ "yes" if adjustment.converged else "NO" }}</b><span>converged, {{ adjustment.iterations
    }} iterations</span></div>
  <div><b>{{ n(adjustment.sigma0) }}</b><span>sigma0</span></div>
  <div><b>{{ adjustment.redundancy }}</b><span>redundancy</span></div>
  <div><b>{{ adjustment.stops }}</b><span>stops</span></div>
  <div><b>{{ adjustment.pairs }}</b><span>stereo pairs</span></div>
  {% for kind, count in adjustment.ties.items() %}
  <div><b>{{ count }}</b><span>{{ kind }} ties</span></div>
  {% endfor %}
  <div><b>{{ adjustment.blunders }}</b><span>blunders set aside</span></div>
</div>

<h2>Weak parts</h2>
{% if quality.weaknesses %}
<ul class="weak">{% for weak in quality.weaknesses[:most] %}
  <li><b>{{ weak.what }}</b>: {{ weak.why }}</li>{% endfor %}
</ul>
{{ left_out(quality.weaknesses) }}
{% else %}<p>None found.</p>{% endif %}

{% if quality.control %}
<h2>Control</h2>
<table>
<tr><th>lies in</th><th class="n">off east, m</th><th class="n">north, m</th>
  <th class="n">1 sigma, m</th><th class="n">turned, degrees</th><th class="n">1 sigma</th>
  <th class="n">scale</th><th class="n">1 sigma</th></tr>
{% for frame in quality.frames %}
<tr><td>{{ frame.name }}</td><td class="n">{{ n(frame.shift_m[0], 2) }}</td>
  <td class="n">{{ n(frame.shift_m[1], 2) }}</td>
  <td class="n">{{ n(frame.sigma_shift_m[0], 2) }}, {{ n(frame.sigma_shift_m[1], 2) }}</td>
  <td class="n">{{ n(frame.rotation_deg, 3) }}</td>
  <td class="n">{{ n(frame.sigma_rotation_deg, 3) }}</td>
  <td class="n">{{ n(1 + frame.scale, 5) }}</td><td class="n">{{ n(frame.sigma_scale, 5) }}</td>
</tr>
{% endfor %}
</table>
<div class="scroll"><table>
<tr><th>stop</th><th>lies in</th><th class="n">1 sigma, m</th>
  <th class="n">residual east, m</th><th class="n">north, m</th>
  <th class="n">in its own sigmas</th><th class="n">redundancy</th><th>status</th></tr>
{% for one in quality.control %}
<tr><td class="id">{{ one.stop }}</td><td>{{ one.frame }}</td>
  <td class="n">{{ n(one.sigma_m[0], 2) }}, {{ n(one.sigma_m[1], 2) }}</td>
  <td class="n">{{ n(one.residual_m[0], 2) }}</td><td class="n">{{ n(one.residual_m[1], 2) }}</td>
  <td class="n">{{ n(one.test, 1) }}</td><td class="n">{{ n(one.redundancy, 2) }}</td>
  <td>{{ "used" if one.used else "set aside" }}{{ ": " ~ one.note if one.note }}</td></tr>
{% endfor %}
</table></div>
<p class="note">Positions of stops in orbital images, measured by hand, or stated by another source
(PLACES table, poses CSV, SPICE kernels), which is named. The position of an image or source as a
whole is an unknown of the adjustment: the error of its georeference, about its centre.</p>
{% endif %}

{% if findings %}
<h2>What images do not determine</h2>
<table>
<tr><th>stop</th><th>lack</th><th class="n">ties</th><th class="n">of six, determined by
  images</th>
  <th>determined by</th></tr>
{% for finding in findings[:most] %}
<tr><td class="id">{{ finding.name }}</td><td>{{ finding.lack }}</td>
  <td class="n">{{ finding.ties }}</td><td class="n">{{ finding.rank }}</td>
  <td>{{ finding.text }}</td></tr>
{% endfor %}
</table>
{{ left_out(findings) }}
<p class="note">Found before anything was solved: how many of the six unknowns of a stop's pose its
ties with earlier stops determine better than telemetry.</p>
{% endif %}

<h2>Consistency</h2>
<table>
<tr><th>ties</th><th class="n">comparisons</th><th class="n">image, before, px</th>
  <th class="n">after, px</th><th class="n">ground, before, m</th><th class="n">after, m</th></tr>
{% for kind, after in adjustment.after.items() %}{% set before = adjustment.before[kind] %}
<tr><td>{{ kind }}</td><td class="n">{{ after.comparisons }}</td>
  <td class="n">{{ n(before.mean_2d_px, 2) }}</td><td class="n">{{ n(after.mean_2d_px, 2) }}</td>
  <td class="n">{{ n(before.mean_3d_m) }}</td><td class="n">{{ n(after.mean_3d_m) }}</td></tr>
{% endfor %}
</table>
<p class="note">Mean absolute differences. On the ground: between the positions of a point by two
pairs, each by its own parallax. In the image: between the measured image point and the
projection of the point. Before: earlier stops as adjusted, new ones by telemetry.</p>

<h2>Traverse</h2>
<figure><img alt="Map of the traverse with error ellipses" src="{{ figures.traverse }}"></figure>
{% if quality.stops|length > 1 %}
<figure><img alt="Standard deviations along the traverse" src="{{ figures.growth }}"></figure>
{% endif %}

<h2>Stops</h2>
<div class="scroll"><table>
<tr><th>stop</th><th>held by</th><th class="n">driven, m</th><th class="n">moved, m</th>
  <th class="n" colspan="3">1-sigma ellipse: axes, m; azimuth</th><th class="n">down, m</th>
  <th class="n" colspan="3">cameras N E D, mm</th>
  <th class="n" colspan="3">turned about N E D, arcmin</th>
</tr>
{% for stop in quality.stops %}
<tr><td class="id">{{ stop.stop }}</td><td>{{ stop.held_by }}</td>
  <td class="n">{{ n(stop.driven_m, 1) }}</td><td class="n">{{ n(stop.moved_m) }}</td>
  {% for axis in stop.ellipse_m %}<td class="n">{{ n(axis) }}</td>{% endfor %}
  <td class="n">{{ n(stop.ellipse_azimuth_deg, 0) }}°</td><td class="n">{{ n(stop.sigma_down_m) }}
  </td>{{ three(stop.precision.position_mm if stop.precision, 1) }}
  {{ three(stop.precision.angles_arcmin if stop.precision, 2) }}</tr>
{% endfor %}
</table></div>
<p class="note">Moved: from the position by telemetry. Standard deviations are those of the
covariance matrix; they include that of the stops held before.</p>

<h2>Internal precision</h2>
<table>
<tr><th>mean standard deviation of</th><th class="n">number</th><th class="n">north</th>
  <th class="n">east</th><th class="n">down</th></tr>
{% if quality.precision %}
<tr><td>camera positions, mm</td><td class="n">{{ quality.precision.pairs }}</td>
  {{ three(quality.precision.position_mm, 1) }}</tr>
<tr><td>camera angles, arc minutes</td><td class="n">{{ quality.precision.pairs }}</td>
  {{ three(quality.precision.angles_arcmin, 2) }}</tr>
{% endif %}
{% for kind, ties in quality.ties.items() %}
<tr><td>{{ kind }} tie points, m</td><td class="n">{{ ties.points }}</td>
  {{ three(ties.mean_m, 3) }}</tr>
<tr><td>{{ kind }} tie points, median, m</td><td class="n"></td>{{ three(ties.median_m, 3) }}</tr>
{% endfor %}
</table>

<h2>Residuals by camera</h2>
<table>
<tr><th>camera</th><th>ties</th><th class="n">observations</th>
  <th class="n" colspan="3">mean: sample, line, parallax, px</th>
  <th class="n" colspan="3">root mean square, px</th><th class="n">rms / estimated</th></tr>
{% for camera in quality.cameras %}{% for kind, found in camera.figures.items() %}
<tr><td>{{ camera.instrument }}</td><td>{{ kind }}</td>
  <td class="n">{{ found.observations }}</td>{{ three(found.mean_px, 3) }}
  {{ three(found.rms_px, 3) }}<td class="n">{{ n(found.rms_standardised, 2) }}</td></tr>
{% endfor %}{% endfor %}
</table>
{% for camera in quality.cameras %}
<figure><img alt="Residuals of {{ camera.instrument }}" src="{{ figures[camera.instrument] }}">
<figcaption class="note">{{ camera.instrument }}, in the epipolar left image. A pattern on the
right that repeats from network to network is the camera's, not chance.</figcaption></figure>
{% endfor %}

<h2>Checks</h2>
<figure><img alt="Standardised residuals and redundancy" src="{{ figures.statistics }}"></figure>
<table>
<tr><th>ties</th><th class="n">observations</th><th class="n">mean redundancy number</th>
  <th class="n">coordinates hardly checked</th></tr>
{% for kind, found in quality.redundancy.items() %}
<tr><td>{{ kind }}</td><td class="n">{{ found.observations }}</td>
  <td class="n">{{ n(found.mean, 2) }}</td><td class="n">{{ found.unchecked }}</td></tr>
{% endfor %}
</table>

{% if quality.components %}
<h2>Sizes of errors</h2>
<table>
<tr><th>observations</th><th class="n">standard deviation stated</th><th class="n">estimated</th>
  <th>unit</th><th class="n">redundancy</th></tr>
{% for one in quality.components %}
<tr><td>{{ one.component }}</td><td class="n">{{ n(one.prior, 2) }}</td>
  <td class="n">{{ n(one.estimate) }}</td><td>{{ one.unit }}</td>
  <td class="n">{{ n(one.redundancy, 0) }}</td></tr>
{% endfor %}
{% for one in quality.mast %}
<tr><td>mast, {{ one.what }}</td><td class="n"></td>
  <td class="n">{{ n(one.value_deg) }} &plusmn; {{ n(one.sigma_deg) }}</td><td>degrees</td>
  <td class="n"></td></tr>
{% endfor %}
</table>
<p class="note">Estimated from all observations of the mission up to here; with little redundancy
they stay near what is stated. The last rows are errors of the mast itself, the same at all
stops.</p>
{% endif %}

{% if quality.links %}
<h2>Links between stops</h2>
<div class="scroll"><table><tr><th>stops</th><th class="n">tie points</th></tr>
{% for link, count in quality.links.items() %}
<tr><td>{{ link }}</td><td class="n">{{ count }}</td></tr>{% endfor %}
</table></div>
{% endif %}

<h2>Blunders set aside</h2>
{% if quality.blunders %}
<div class="scroll"><table>
<tr><th>pair</th><th class="n">sample</th><th class="n">line</th><th class="n">parallax</th>
  <th class="n" colspan="3">residual: sample, line, parallax, px</th>
  <th>other pairs of the point</th></tr>
{% for blunder in quality.blunders[:most] %}
<tr><td class="id">{{ blunder.pair_id }}</td>{% for value in blunder.left_px %}
  <td class="n">{{ n(value, 1) }}</td>{% endfor %}<td class="n">{{ n(blunder.parallax_px, 1) }}</td>
  {{ three(blunder.residual_px, 1) }}<td>{{ blunder.others|join(", ") or "nothing" }}</td></tr>
{% endfor %}
</table></div>
{{ left_out(quality.blunders) }}
{% else %}<p>None.</p>{% endif %}
</body>
</html>
"""
MOST_ROWS = 200
"""Weak parts or blunders shown; all of them are in the JSON."""


def report_page(title: str, document: Mapping[str, Any], figures: Mapping[str, bytes]) -> str:
    """The page of a quality document with its figures (SVG), by name."""
    page = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True).from_string(
        PAGE
    )
    return page.render(
        title=title,
        adjustment=document["adjustment"],
        quality=document["quality"],
        figures={name: _data_url(svg) for name, svg in figures.items()},
        findings=[
            finding | {"name": str(StopId(**finding["stop"]))}
            for finding in document["adjustment"].get("findings", ())
        ],
        most=MOST_ROWS,
        left_out=_left_out,
    )


def _left_out(rows: list[Any]) -> str:
    more = len(rows) - MOST_ROWS
    return f"and {more} more, in the JSON beside this page" if more > 0 else ""


def _data_url(svg: bytes) -> str:
    return "data:image/svg+xml;base64," + base64.b64encode(svg).decode()
