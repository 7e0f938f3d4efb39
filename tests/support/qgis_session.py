"""What QGIS makes of a server's layers: run by the machine's own Python, which has `qgis.core`.

    python3 qgis_session.py QUERY.json ANSWER.json

QUERY holds layers by name: provider, address, `picture` where one is to be drawn, `at` for the
value of a raster at a place, and `field` for the values of an attribute. ANSWER gives what QGIS
found of each. It does not depend on this project.
"""

import json
import sys
from pathlib import Path

from qgis.core import (
    QgsApplication,
    QgsMapRendererParallelJob,
    QgsMapSettings,
    QgsPointXY,
    QgsRasterLayer,
    QgsRectangle,
    QgsVectorLayer,
)
from qgis.PyQt.QtCore import QSize
from qgis.PyQt.QtGui import QColor


def opened(requested):
    """The layer and its general properties."""
    kinds = {"wms": QgsRasterLayer, "gdal": QgsRasterLayer}
    layer = kinds.get(requested["provider"], QgsVectorLayer)(
        requested["address"], "asked", requested["provider"]
    )
    crs, extent = layer.crs(), layer.extent()
    reported = {
        "valid": layer.isValid(),
        "crs": crs.authid(),
        "crs_wkt": crs.toWkt(),
        "crs_ellipsoid": crs.ellipsoidAcronym(),
        "crs_proj": crs.toProj(),
        "extent": [extent.xMinimum(), extent.yMinimum(), extent.xMaximum(), extent.yMaximum()],
    }
    return layer, reported


def drawn(layer, requested):
    """An image of the layer in its own reference system."""
    settings = QgsMapSettings()
    settings.setLayers([layer])
    settings.setDestinationCrs(layer.crs())
    settings.setBackgroundColor(QColor(255, 255, 255))
    settings.setOutputSize(QSize(400, 400))
    settings.setExtent(QgsRectangle(*requested["view"]) if "view" in requested else layer.extent())
    job = QgsMapRendererParallelJob(settings)
    job.start()
    job.waitForFinished()
    job.renderedImage().save(requested["picture"])
    return [error.message for error in job.errors()]


def reported_of(requested):
    layer, reported = opened(requested)
    if not reported["valid"]:
        return reported
    if requested["provider"] not in {"wms", "gdal"}:
        features = list(layer.getFeatures())
        reported["count"] = len(features)
        reported["fields"] = layer.fields().names()
        if "field" in requested:
            reported["values"] = [
                [feature[requested["field"]], *_middle(feature)] for feature in features[:2000]
            ]
    if "at" in requested:
        value, is_known = layer.dataProvider().sample(QgsPointXY(*requested["at"]), 1)
        reported["value"] = value if is_known else None
    if "picture" in requested:
        reported["errors"] = drawn(layer, requested)
    return reported


def _middle(feature):
    middle = feature.geometry().centroid().asPoint()
    return [middle.x(), middle.y()]


def main():
    QgsApplication.setPrefixPath("/usr", True)  # noqa: FBT003 - Qt's own
    application = QgsApplication([], False)  # noqa: FBT003 - as above
    application.initQgis()
    requested = json.loads(Path(sys.argv[1]).read_text())
    answer = {name: reported_of(one) for name, one in requested.items()}
    Path(sys.argv[2]).write_text(json.dumps(answer, default=str))
    application.exitQgis()


if __name__ == "__main__":
    main()
