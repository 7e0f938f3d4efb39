"""A small but complete image file, made to be changed."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

LABEL = """PDS_VERSION_ID                   = PDS3
RECORD_TYPE                      = FIXED_LENGTH
RECORD_BYTES                     = {record_bytes}
LABEL_RECORDS                    = {label_records}
^IMAGE                           = {image_record}

 FRAME_ID                        = "{eye}"
 GEOMETRY_PROJECTION_TYPE        = {projection}
 IMAGE_TYPE                      = {image_type}
 INSTRUMENT_HOST_ID              = "MER2"
 INSTRUMENT_ID                   = "{instrument}_{eye}"
 LOCAL_TRUE_SOLAR_TIME           = "11:23:54"
 PLANET_DAY_NUMBER               = 1869
 PRODUCT_ID                      = "2N292280938EFFB100P0703L0M1"
 ROVER_MOTION_COUNTER            = {counter}
 SEQUENCE_ID                     = "p0703"
 SPACECRAFT_CLOCK_START_COUNT    = "292280938.496"
 START_TIME                      = 2009-04-06T08:48:13.468

GROUP                            = GEOMETRIC_CAMERA_MODEL
  MODEL_TYPE                     = CAHVOR
  MODEL_COMPONENT_ID             = ("C","A","H","V","O","R")
  MODEL_COMPONENT_1              = (0.454993,0.141198,-1.23312)
  MODEL_COMPONENT_2              = (-0.69585,0.571462,0.435)
  MODEL_COMPONENT_3              = (-1075.03,-654.572,220.543)
  MODEL_COMPONENT_4              = (50.6594,-19.3653,1294.76)
  MODEL_COMPONENT_5              = (-0.61985,0.672629,0.404174)
  MODEL_COMPONENT_6              = (0.019876,-0.014281,0.020876)
  REFERENCE_COORD_SYSTEM_NAME    = ROVER_FRAME
END_GROUP                        = GEOMETRIC_CAMERA_MODEL

GROUP                            = ROVER_COORDINATE_SYSTEM
  ORIGIN_OFFSET_VECTOR           = (1.0,2.0,-0.5)
  ORIGIN_ROTATION_QUATERNION     = (0.994261,-0.095668,-0.0233068,0.0418276)
  QUATERNION_MEASUREMENT_METHOD  = FINE
  REFERENCE_COORD_SYSTEM_INDEX   = 137
  REFERENCE_COORD_SYSTEM_NAME    = SITE_FRAME
END_GROUP                        = ROVER_COORDINATE_SYSTEM

GROUP                            = PMA_COORDINATE_SYSTEM
  ORIGIN_ROTATION_QUATERNION     = (0.317432,0.21062,-0.0725336,0.921746)
END_GROUP                        = PMA_COORDINATE_SYSTEM

GROUP                            = INSTRUMENT_STATE_PARMS
  PIXEL_AVERAGING_HEIGHT         = 1
  PIXEL_AVERAGING_WIDTH          = 1
END_GROUP                        = INSTRUMENT_STATE_PARMS

GROUP                            = ROVER_DERIVED_GEOMETRY_PARMS
  INSTRUMENT_AZIMUTH             = 141.994 <deg>
  INSTRUMENT_ELEVATION           = -25.7423 <deg>
END_GROUP                        = ROVER_DERIVED_GEOMETRY_PARMS

GROUP                            = SITE_DERIVED_GEOMETRY_PARMS
  SOLAR_AZIMUTH                  = 131.496 <deg>
  SOLAR_ELEVATION                = 78.801 <deg>
END_GROUP                        = SITE_DERIVED_GEOMETRY_PARMS

OBJECT                           = IMAGE
  LINES                          = {lines}
  LINE_SAMPLES                   = {samples}
  SAMPLE_TYPE                    = {sample_type}
  SAMPLE_BITS                    = {sample_bits}
  BANDS                          = {bands}
  BAND_STORAGE_TYPE              = {storage}
  MISSING_CONSTANT               = 0.0
END_OBJECT                       = IMAGE
END
"""


@dataclass(frozen=True)
class SmallImage:
    """An image file of a few pixels; `but` changes its label by replacing text."""

    pixels: np.ndarray
    stored: str = ">i2"
    sample_type: str = "MSB_INTEGER"
    bands: int = 1
    storage: str = "BAND_SEQUENTIAL"
    eye: str = "LEFT"
    instrument: str = "NAVCAM"
    projection: str = "RAW"
    image_type: str = "REGULAR"
    counter: str = "(137,0,0,13,7)"
    replacing: tuple[tuple[str, str], ...] = ()

    def but(self, old: str, new: str) -> "SmallImage":
        """The same file with other words in its label."""
        return replace(self, replacing=(*self.replacing, (old, new)))

    @property
    def label(self) -> str:
        lines, samples = self.pixels.shape[-2:]
        if self.storage == "SAMPLE_INTERLEAVED":
            lines, samples = self.pixels.shape[:2]
        elif self.storage == "LINE_INTERLEAVED":
            lines, samples = self.pixels.shape[0], self.pixels.shape[2]
        text = LABEL.format(
            record_bytes=512,
            label_records=8,
            image_record=9,
            eye=self.eye,
            instrument=self.instrument,
            projection=self.projection,
            image_type=self.image_type,
            counter=self.counter,
            lines=lines,
            samples=samples,
            sample_type=self.sample_type,
            sample_bits=np.dtype(self.stored).itemsize * 8,
            bands=self.bands,
            storage=self.storage,
        )
        for old, new in self.replacing:
            assert old in text
            text = text.replace(old, new)
        return text

    @property
    def data(self) -> bytes:
        head = self.label.encode().ljust(8 * 512)
        assert len(head) == 8 * 512
        return head + self.pixels.astype(self.stored).tobytes()


@pytest.fixture
def small(rng) -> SmallImage:
    """Twelve-bit values, none of them zero."""
    return SmallImage(rng.integers(1, 4096, (40, 60)))
