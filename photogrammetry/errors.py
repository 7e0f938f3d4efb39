"""The errors of the science, raised where the facts are known."""


class PhotogrammetryError(Exception):
    """Something about the data that the computation cannot go on from."""


class LabelError(PhotogrammetryError):
    """A label is broken or lacks what is needed; names the keyword and what was expected."""


class PixelError(PhotogrammetryError):
    """The pixels are not where or what the label says."""


class VectorFileError(PhotogrammetryError):
    """A site or rover vector file is broken; names the element."""


class CameraError(PhotogrammetryError):
    """A camera model is impossible or was asked for something it cannot do."""


class FrameError(PhotogrammetryError):
    """Two poses do not meet in a frame, or a frame cannot be reached."""


class MatchingError(PhotogrammetryError):
    """Two images cannot be matched."""


class AdjustmentError(PhotogrammetryError):
    """The network cannot be adjusted."""


class TerrainError(PhotogrammetryError):
    """A terrain product cannot be computed."""


class TraverseError(PhotogrammetryError):
    """Traverses that cannot be compared or put on the map."""


class OrbitalError(PhotogrammetryError):
    """Orbital images and rover maps that cannot be laid on each other."""
