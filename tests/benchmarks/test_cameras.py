"""How fast cameras project: a million points, against the formulas written down plainly."""

import numpy as np
import pytest

from solmap.photogrammetry.cameras.cahvor import Cahvor
from solmap.photogrammetry.cameras.cahvore import Cahvore

POINTS = 1_000_000

NAVCAM = Cahvor(  # Spirit, left Navcam, sol 1869
    c=np.array([0.454993, 0.141198, -1.23312]),
    a=np.array([-0.69585, 0.571462, 0.435]),
    h=np.array([-1075.03, -654.572, 220.543]),
    v=np.array([50.6594, -19.3653, 1294.76]),
    o=np.array([-0.61985, 0.672629, 0.404174]),
    r=np.array([0.019876, -0.014281, 0.020876]),
)
HAZCAM = Cahvore(  # Opportunity, front left Hazcam, sol 4000
    c=np.array([0.609331, -0.041064, -0.233849]),
    a=np.array([0.703447, -0.005161, 0.710729]),
    h=np.array([351.362, 452.204, 353.494]),
    v=np.array([35.8065, -1.75143, 682.705]),
    o=np.array([0.704402, -0.006062, 0.709775]),
    r=np.array([3e-06, -0.012015, -0.007525]),
    e=np.array([0.001442, 0.001522, 0.000483]),
    type=3,
    parameter=0.37,
)


def plain_cahvor(camera, points):
    """The facts' 3.3, line by line."""
    d = points - camera.c
    w = d @ camera.o
    l = d - w[:, None] * camera.o
    tau = (l * l).sum(axis=1) / w**2
    mu = camera.r[0] + camera.r[1] * tau + camera.r[2] * tau**2
    moved = d + mu[:, None] * l
    depth = moved @ camera.a
    return np.column_stack([moved @ camera.h / depth, moved @ camera.v / depth])


@pytest.fixture(scope="module")
def image_points():
    return np.random.default_rng(0).uniform(0, 1023, (POINTS, 2))


@pytest.fixture(scope="module")
def navcam_points(image_points):
    return NAVCAM.c + 10 * NAVCAM.rays(image_points)


def test_projecting_a_million_cahvor_points(benchmark, navcam_points):
    found = benchmark(NAVCAM.project, navcam_points)
    benchmark.extra_info["points_per_second"] = POINTS / benchmark.stats["mean"]
    np.testing.assert_allclose(found, plain_cahvor(NAVCAM, navcam_points), atol=1e-9)


def test_projecting_a_million_cahvor_points_by_the_formulas(benchmark, navcam_points):
    benchmark(plain_cahvor, NAVCAM, navcam_points)
    benchmark.extra_info["points_per_second"] = POINTS / benchmark.stats["mean"]


def test_a_million_cahvor_rays(benchmark, image_points):
    benchmark(NAVCAM.rays, image_points)


def test_projecting_a_million_cahvore_points(benchmark, image_points):
    points = HAZCAM.ray_origins(image_points) + 3 * HAZCAM.rays(image_points)
    found = benchmark(HAZCAM.project, points)
    # O has the six digits of the label, which costs the way there and back 1e-4 px.
    np.testing.assert_allclose(found, image_points, atol=1e-3)
