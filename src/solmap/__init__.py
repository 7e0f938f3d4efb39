"""solmap: from a Mars rover's stereo images to maps in the browser."""

__version__ = "0.1.0"
