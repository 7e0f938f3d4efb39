"""solmap: from a Mars rover's stereo images to maps in the browser.

    import solmap

    pair = solmap.StereoPair("2n...l0m1.img", "2n...r0m1.img")
    dtm = solmap.build_dtm(pair)
    with solmap.open_store("STORE").latest("dtm", sol=156) as raster:
        elevation = raster.read(1)

`docs/reference/python.md` and the notebooks in `docs/tutorials` show more. Names are imported
when they are first used: `import solmap` itself takes milliseconds.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from solmap.science import (
        Adjustment,
        Camera,
        Image,
        Orthophoto,
        Simulation,
        StereoMatch,
        StereoPair,
        adjust,
        build_dtm,
        orthophoto,
        read_image,
        simulate,
    )
    from solmap.stores import Store, open_store

__all__ = [
    "Adjustment",
    "Camera",
    "Image",
    "Orthophoto",
    "Simulation",
    "StereoMatch",
    "StereoPair",
    "Store",
    "adjust",
    "build_dtm",
    "open_store",
    "orthophoto",
    "read_image",
    "simulate",
]


def __getattr__(name: str) -> Any:  # noqa: ANN401 - any of the names above
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = "stores" if name in {"Store", "open_store"} else "science"
    return getattr(import_module(f"{__name__}.{module}"), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
