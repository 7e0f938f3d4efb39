"""The camera models of the test vectors, and where they look."""

from typing import Any

import numpy as np
import pytest

from solmap.photogrammetry.cameras.cahv import Cahv
from solmap.photogrammetry.cameras.cahvor import Cahvor
from solmap.photogrammetry.cameras.cahvore import Cahvore


def camera_of(entry: dict[str, Any]) -> Cahv | Cahvor | Cahvore:
    """The model that an entry of the vectors spells out."""
    vectors = {k.lower(): np.array(entry[k], dtype=float) for k in "CAHVORE" if k in entry}
    if "e" in vectors:
        return Cahvore(**vectors, type=int(entry["T"]), parameter=float(entry["P"]))
    return Cahvor(**vectors) if "o" in vectors else Cahv(**vectors)


def true_unit(camera):
    """The same model with an O of unit length beyond the digits of a label."""
    if isinstance(camera, Cahv):
        return camera
    fields = {name: getattr(camera, name) for name in camera.__dataclass_fields__}
    return type(camera)(**{**fields, "o": camera.o / np.linalg.norm(camera.o)})


@pytest.fixture(scope="session")
def cameras(test_vectors) -> dict[str, Cahv | Cahvor | Cahvore]:
    """Every camera of the vectors by name."""
    return {name: camera_of(entry) for name, entry in test_vectors["cameras"].items()}


@pytest.fixture(scope="session")
def unit_cameras(cameras):
    """The cameras with a true unit vector O."""
    return {name: true_unit(camera) for name, camera in cameras.items()}


NAVCAM = Cahvor(  # Spirit, left Navcam, sol 1869
    c=np.array([0.454993, 0.141198, -1.23312]),
    a=np.array([-0.69585, 0.571462, 0.435]),
    h=np.array([-1075.03, -654.572, 220.543]),
    v=np.array([50.6594, -19.3653, 1294.76]),
    o=np.array([-0.61985, 0.672629, 0.404174]) / np.linalg.norm([-0.61985, 0.672629, 0.404174]),
    r=np.array([0.019876, -0.014281, 0.020876]),
)
HAZCAM = Cahvore(  # Opportunity, front left Hazcam, sol 4000
    c=np.array([0.609331, -0.041064, -0.233849]),
    a=np.array([0.703447, -0.005161, 0.710729]),
    h=np.array([351.362, 452.204, 353.494]),
    v=np.array([35.8065, -1.75143, 682.705]),
    o=np.array([0.704402, -0.006062, 0.709775]) / np.linalg.norm([0.704402, -0.006062, 0.709775]),
    r=np.array([3e-06, -0.012015, -0.007525]),
    e=np.array([0.001442, 0.001522, 0.000483]),
    type=3,
    parameter=0.37,
)


@pytest.fixture(scope="session")
def navcam() -> Cahvor:
    """Spirit's left Navcam."""
    return NAVCAM


@pytest.fixture(scope="session")
def hazcam() -> Cahvore:
    """Opportunity's front left Hazcam."""
    return HAZCAM


@pytest.fixture(scope="session", params=["CAHV", "CAHVOR", "CAHVORE 1", "CAHVORE 2", "CAHVORE 3"])
def model(request):
    """One model of every type."""
    if request.param == "CAHV":
        return NAVCAM.perspective
    if request.param == "CAHVOR":
        return NAVCAM
    fields = {name: getattr(HAZCAM, name) for name in HAZCAM.__dataclass_fields__}
    return Cahvore(**{**fields, "type": int(request.param[-1])})


@pytest.fixture
def in_view(model, rng):
    """Points that the model images, 0.5 to 100 m away, and their image points."""
    image_points = rng.uniform(0, 1023, (200, 2))
    distances = np.geomspace(0.5, 100, 200)[:, None]
    return model.ray_origins(image_points) + distances * model.rays(image_points), image_points
