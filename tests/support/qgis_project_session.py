"""What QGIS makes of a project: run by the machine's own Python, which has `qgis.core`.

    python3 qgis_project_session.py PROJECT.qgz ANSWER.json IMAGE.png

ANSWER states how the project and each of its layers were opened; IMAGE shows the layers that are
switched on, within the extent that the project opens with. It does not depend on this project.
"""

import json
import sys
from pathlib import Path

from qgis.core import QgsApplication, QgsMapRendererParallelJob, QgsMapSettings, QgsProject
from qgis.PyQt.QtCore import QSize
from qgis.PyQt.QtGui import QColor


def of_layer(node):
    layer = node.layer()
    box = layer.extent()
    renderer = layer.renderer() if layer.isValid() else None
    reported = {
        "name": node.name(),
        "group": node.parent().name(),
        "shown": node.itemVisibilityChecked(),
        "valid": layer.isValid(),
        "provider": layer.providerType(),
        "source": layer.source(),
        "crs_proj": layer.crs().toProj(),
        "crs_name": layer.crs().description(),
        "crs_wkt": layer.crs().toWkt(),
        "extent": [box.xMinimum(), box.yMinimum(), box.xMaximum(), box.yMaximum()],
        "renderer": renderer.type() if renderer else None,
    }
    if renderer and renderer.type() == "singlebandpseudocolor":
        items = renderer.shader().rasterShaderFunction().colorRampItemList()
        reported["colours"] = [[item.value, item.color.name()] for item in items]
        reported["band"] = renderer.band()
    elif renderer and renderer.type() == "paletted":
        reported["colours"] = [
            [one.value, one.color.name(), one.label] for one in renderer.classes()
        ]
    elif renderer and renderer.type() == "categorizedSymbol":
        reported["colours"] = [
            [one.value(), one.symbol().color().name()] for one in renderer.categories()
        ]
    elif renderer and renderer.type() == "singleSymbol":
        reported["symbol"] = renderer.symbol().symbolLayer(0).layerType()
        reported["geometry"] = layer.geometryType()
        reported["count"] = layer.featureCount()
    return reported


def drawn(project, image):
    settings = QgsMapSettings()
    root = project.layerTreeRoot()
    shown = [node.layer() for node in root.findLayers() if node.isVisible()]
    settings.setLayers(shown)
    settings.setDestinationCrs(project.crs())
    settings.setTransformContext(project.transformContext())
    settings.setBackgroundColor(QColor(255, 255, 255))
    settings.setOutputSize(QSize(600, 600))
    settings.setExtent(project.viewSettings().defaultViewExtent())
    job = QgsMapRendererParallelJob(settings)
    job.start()
    job.waitForFinished()
    job.renderedImage().save(image)
    box = settings.visibleExtent()
    return {
        "errors": [error.message for error in job.errors()],
        "extent": [box.xMinimum(), box.yMinimum(), box.xMaximum(), box.yMaximum()],
    }


def main():
    source, answer, image = sys.argv[1:]
    QgsApplication.setPrefixPath("/usr", True)  # noqa: FBT003 - Qt's own
    application = QgsApplication([], False)  # noqa: FBT003 - as above
    application.initQgis()
    project = QgsProject.instance()
    opened = project.read(source)
    reported = {
        "opened": opened,
        "error": project.error(),
        "title": project.title(),
        "crs_proj": project.crs().toProj(),
        "crs_name": project.crs().description(),
        "crs_valid": project.crs().isValid(),
        "ellipsoid": project.ellipsoid(),
        "layers": [of_layer(node) for node in project.layerTreeRoot().findLayers()],
        "drawn": drawn(project, image),
    }
    Path(answer).write_text(json.dumps(reported, default=str))
    application.exitQgis()


if __name__ == "__main__":
    main()
