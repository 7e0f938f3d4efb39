"""Tie points as an ISIS control network in PVL, version 5.

Adjusted places are body-fixed (x, y, z) in metres: `camera_network.body_fixed`. Covariance matrices
are upper triangles, row by row. Samples and lines count from 1 at the centre of the first pixel, in
the epipolar images of the same export; their identifiers replace serial numbers, because ISIS has
no cameras of these rovers.

Source: `ControlNetVersioner` of USGS ISIS.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from solmap.products.crs import LandingPoint
from solmap.products.export.camera_network import CameraNetwork, body_fixed
from solmap.products.store.provenance import SOFTWARE


def control_network_text(
    network: CameraNetwork, name: str, landing: LandingPoint, made_at: str
) -> Iterator[str]:
    """The control network, piece by piece.

    Args:
        network: Cameras and tie points.
        name: Identifier of the control network.
        landing: Origin of the map, on Mars.
        made_at: When the network was adjusted, ISO 8601.
    """
    when = made_at.partition("+")[0]
    yield "Object = ControlNetwork\n"
    for key, value in {
        "NetworkId": name,
        "TargetName": "Mars",
        "UserName": SOFTWARE.replace(" ", "-"),
        "Created": when,
        "LastModified": when,
        "Description": f'"Tie points of {name}, adjusted by {SOFTWARE}"',
        "Version": "5",
    }.items():
        yield f"  {key} = {value}\n"
    turn, origin = body_fixed(landing)
    places = network.points @ turn.T + origin
    covariances = turn @ network.covariances @ turn.T
    residuals = network.residuals_px()
    ends = np.searchsorted(network.point, np.arange(len(places) + 1))
    for number, place in enumerate(places.tolist()):
        yield "\n  Object = ControlPoint\n    PointType = Free\n"
        yield f"    PointId = {name}_{number + 1}\n"
        yield f"    ChooserName = solmap\n    DateTime = {when}\n"
        yield "    AprioriXYZSource = BundleSolution\n    AprioriRadiusSource = BundleSolution\n"
        for prefix in ("Apriori", "Adjusted"):
            for axis, value in zip("XYZ", place, strict=True):
                yield f"    {prefix}{axis} = {value:.5f} <meters>\n"
        if np.isfinite(covariances[number]).all():
            values = covariances[number][np.triu_indices(3)].tolist()
            triangle = ", ".join(f"{value:.6e}" for value in values)
            yield f"    AdjustedCovarianceMatrix = ({triangle})\n"
        for row in range(ends[number], ends[number + 1]):
            yield from _measure(network, row, residuals[row], when, is_first=row == ends[number])
        yield "  End_Object\n"
    yield "End_Object\nEnd\n"


def _measure(
    network: CameraNetwork, row: int, residual: np.ndarray, when: str, *, is_first: bool
) -> Iterator[str]:
    sample, line = network.at[row] + 1.0
    sigma = network.sigma_px[row]
    yield "\n    Group = ControlMeasure\n"
    yield f"      SerialNumber = {network.views[network.view[row]].name}\n"
    yield "      MeasureType = RegisteredSubPixel\n"
    yield f"      ChooserName = solmap\n      DateTime = {when}\n"
    yield f"      Sample = {sample:.4f}\n      Line = {line:.4f}\n"
    yield f"      SampleResidual = {residual[0]:.4f} <pixels>\n"
    yield f"      LineResidual = {residual[1]:.4f} <pixels>\n"
    yield f"      SampleSigma = {sigma:.4f} <pixels>\n      LineSigma = {sigma:.4f} <pixels>\n"
    if is_first:
        yield "      Reference = True\n"
    yield "    End_Group\n"
