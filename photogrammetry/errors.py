"""The errors of the science packages."""


class PhotogrammetryError(Exception):
    """The data do not permit the computation."""


class LabelError(PhotogrammetryError):
    """A label is broken or incomplete; the message names the keyword and the expected value."""


class PixelError(PhotogrammetryError):
    """The pixels contradict the label."""


class VectorFileError(PhotogrammetryError):
    """A site or rover vector file is broken; the message names the element."""


class CameraError(PhotogrammetryError):
    """A camera model is impossible or does not support the operation."""


class FrameError(PhotogrammetryError):
    """Two poses do not share a frame, or a frame is not connected."""


class MatchingError(PhotogrammetryError):
    """Two images cannot be matched."""


class AdjustmentError(PhotogrammetryError):
    """The network cannot be adjusted."""


class TerrainError(PhotogrammetryError):
    """A terrain product cannot be computed."""


class TraverseError(PhotogrammetryError):
    """Traverses that cannot be compared or located on the map."""


class OrbitalError(PhotogrammetryError):
    """Orbital images and rover maps that cannot be registered."""
