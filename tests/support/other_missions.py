"""Simulated images of Spirit as files of Curiosity and Perseverance, in every form these come in.

Labels contain the values of the image's record, in the keywords and file names of the other
mission, so each form of one image should lead to the same map.
"""

import json
import re

import cv2
import numpy as np

from solmap.photogrammetry.archive.images.reading import ReadImage
from solmap.photogrammetry.synthetic.edr import format_vector

NAVCAMS = {"MSL": "NAV_{}_B", "M20": "NAVCAM_{}"}
PDS4 = """<?xml version="1.0" encoding="UTF-8"?>
<Product_Observational xmlns="http://pds.nasa.gov/pds4/pds/v1"
    xmlns:geom="http://pds.nasa.gov/pds4/geom/v1" xmlns:img="http://pds.nasa.gov/pds4/img/v1"
    xmlns:img_surface="http://pds.nasa.gov/pds4/img_surface/v1"
    xmlns:msn="http://pds.nasa.gov/pds4/msn/v1"
    xmlns:msn_surface="http://pds.nasa.gov/pds4/msn_surface/v1">
<Identification_Area>
 <logical_identifier>urn:nasa:pds:mars2020_navcam_ops_raw:data:{lid}</logical_identifier>
 <version_id>1.0</version_id><title>{name}</title>
</Identification_Area>
<Observation_Area><Discipline_Area>
 <geom:Geometry><geom:Geometry_Lander><geom:geometry_state>Telemetry</geom:geometry_state>
  <geom:Camera_Model_Parameters><geom:model_type>CAHVOR</geom:model_type>
   <geom:CAHVOR_Model>{model}</geom:CAHVOR_Model>
   <geom:Coordinate_Space_Reference><geom:Coordinate_Space_Indexed>
    <geom:coordinate_space_frame_type>ROVER_NAV_FRAME</geom:coordinate_space_frame_type>
   </geom:Coordinate_Space_Indexed></geom:Coordinate_Space_Reference>
  </geom:Camera_Model_Parameters>
  <geom:Coordinate_Space_Definition>
   <geom:Coordinate_Space_Present><geom:Coordinate_Space_Indexed>
    <geom:coordinate_space_frame_type>ROVER_NAV_FRAME</geom:coordinate_space_frame_type>{counter}
   </geom:Coordinate_Space_Indexed></geom:Coordinate_Space_Present>
   {offset}
   <geom:Quaternion_Plus_Direction>{turn}
    <geom:rotation_direction>Forward</geom:rotation_direction></geom:Quaternion_Plus_Direction>
   <geom:Coordinate_Space_Reference><Local_Internal_Reference>
    <local_identifier_reference>SITE_FRAME_{site}</local_identifier_reference>
   </Local_Internal_Reference></geom:Coordinate_Space_Reference>
  </geom:Coordinate_Space_Definition>
 </geom:Geometry_Lander></geom:Geometry>
 <img_surface:Surface_Imaging><img_surface:Instrument_Information>
  <img_surface:image_type>REGULAR</img_surface:image_type>
  <img_surface:ops_instrument_key>{instrument}</img_surface:ops_instrument_key>
 </img_surface:Instrument_Information></img_surface:Surface_Imaging>
 <msn:Mission_Information><msn:spacecraft_clock_start>{clock}</msn:spacecraft_clock_start>
  <msn:Surface_Mission><msn:start_sol_number>{sol}</msn:start_sol_number></msn:Surface_Mission>
 </msn:Mission_Information>
</Discipline_Area></Observation_Area>
<File_Area_Observational><File><file_name>{name}.IMG</file_name></File>
 <Array_2D_Image><offset unit="byte">0</offset><axes>2</axes>
  <Element_Array><data_type>SignedMSB2</data_type></Element_Array>
  <Axis_Array><axis_name>Line</axis_name><elements>{lines}</elements>
   <sequence_number>1</sequence_number></Axis_Array>
  <Axis_Array><axis_name>Sample</axis_name><elements>{samples}</elements>
   <sequence_number>2</sequence_number></Axis_Array>
 </Array_2D_Image>
</File_Area_Observational>
</Product_Observational>
"""


def name_of(read: ReadImage, mission: str, part: str = "00_0") -> str:
    """The name of an image, without extension."""
    image = read.image
    eye, stop, clock = image.eye[0].upper(), image.stop, int(image.clock)
    if mission == "MSL":
        return f"N{eye}B_{clock:09d}EDR_F{stop.site:03d}{stop.drive:04d}NCAM00001M1"
    return (
        f"N{eye}F_{image.sol:04d}_{clock:010d}_000ECM_N{stop.site:03d}{stop.drive:04d}"
        f"NCAM00001_{part}95J01"
    )


def instrument_of(read: ReadImage, mission: str) -> str:
    return NAVCAMS[mission].format(read.image.eye.upper())


def pds3_file(data: bytes, read: ReadImage, mission: str) -> bytes:
    """An .IMG with an attached label, of the bytes of Spirit's; as long as these."""
    camera = read.image.camera
    record_bytes = int(re.search(rb"RECORD_BYTES\s+= (\d+)", data)[1])
    end = record_bytes * int(re.search(rb"LABEL_RECORDS\s+= (\d+)", data)[1])
    label = data[:end].rstrip()
    for old, new in {
        '"MER2"': f'"{mission}"',
        f'"NAVCAM_{read.image.eye.upper()}"': f'"{instrument_of(read, mission)}"',
        "PMA_COORDINATE_SYSTEM": "RSM_COORDINATE_SYSTEM",
        "PDS_VERSION_ID                    = PDS3": "ODL_VERSION_ID                    = ODL3",
    }.items():
        label = label.replace(old.encode(), new.encode())
    for number, vector in (3, camera.h), (4, camera.v):  # with the half pixel that MER leaves out
        keyword = rf"(MODEL_COMPONENT_{number}\s+= )\([^)]*\)".encode()
        label = re.sub(keyword, rb"\1" + format_vector(vector).encode(), label)
    assert len(label) <= end
    return label.ljust(end) + data[end:]


def pds4_product(read: ReadImage) -> tuple[bytes, bytes]:
    """Label and data of a PDS4 product of Perseverance."""
    image, camera, pose = read.image, read.image.camera, read.image.site_from_rover
    name = name_of(read, "M20")
    letters = (
        ("Vector_Center", "x_position y_position z_position", camera.c),
        ("Vector_Axis", "x_unit y_unit z_unit", camera.a),
        ("Vector_Horizontal", "x_pixel y_pixel z_pixel", camera.h),
        ("Vector_Vertical", "x_pixel y_pixel z_pixel", camera.v),
        ("Vector_Optical", "x_unit y_unit z_unit", camera.o),
        ("Radial_Terms", "c0 c1 c2", camera.r),
    )
    counter = "".join(
        f"<geom:Coordinate_Space_Index><geom:index_id>{key}</geom:index_id>"
        f"<geom:index_value_number>{count}</geom:index_value_number></geom:Coordinate_Space_Index>"
        for key, count in zip(("SITE", "DRIVE"), image.motion_counter, strict=False)
    )
    label = PDS4.format(
        lid=name.lower()[:-2],
        name=name,
        model="".join(_class(tag, names, values) for tag, names, values in letters),
        counter=counter,
        offset=_class(
            "Vector_Origin_Offset", "x_position y_position z_position", pose.translation_m
        ),
        turn=_items("qcos qsin1 qsin2 qsin3", pose.quaternion),
        site=image.stop.site,
        instrument=instrument_of(read, "M20"),
        clock=image.clock,
        sol=image.sol,
        lines=image.lines,
        samples=image.samples,
    )
    return label.encode(), np.round(read.pixels).astype(">i2").tobytes()


def _class(tag: str, names: str, values: np.ndarray) -> str:
    return f"<geom:{tag}>{_items(names, values)}</geom:{tag}>"


def _items(names: str, values: np.ndarray) -> str:
    pairs = zip(names.split(), values, strict=True)
    return "".join(f"<geom:{name}>{value:.9g}</geom:{name}>" for name, value in pairs)


def raw_image(read: ReadImage, mission: str) -> tuple[str, bytes, dict]:
    """Name and bytes of a public raw image, and its item in the list of its mission."""
    image, camera, pose = read.image, read.image.camera, read.image.site_from_rover
    vectors = (camera.c, camera.a, camera.h, camera.v, camera.o, camera.r)

    def text(values) -> str:
        return "(" + ",".join(f"{value:.9g}" for value in values) + ")"

    grey = (read.pixels / 16).clip(1, 255).round().astype(np.uint8)
    suffix = {"MSL": ".JPG", "M20": ".png"}[mission]
    quality = [cv2.IMWRITE_JPEG_QUALITY, 98] if mission == "MSL" else []
    png = cv2.imencode(suffix, grey, quality)[1].tobytes()
    name = name_of(read, mission)
    model = {
        "camera_model_type": "CAHVOR",
        "camera_model_component_list": ";".join(map(text, vectors)),
        "camera_position": text(camera.c),
        "instrument": instrument_of(read, mission),
    }
    part = f"(1,1,{image.samples},{image.lines})"
    if mission == "MSL":
        name = name[:-1] + "_"
        return (
            name + suffix,
            png,
            {
                "imageid": name,
                "sol": image.sol,
                "site": image.stop.site,
                "drive": image.stop.drive,
                "spacecraft_clock": image.clock,
                "subframe_rect": part,
                "scale_factor": 1,
                "xyz": text(pose.translation_m),
                "attitude": text(pose.quaternion),
                "date_taken": "2016-08-14T10:21:05.000Z",
                "mission": "msl",
                "is_thumbnail": False,
                "extended": {"sample_type": "full", "mast_az": "1.0", "lmst": None},
                **model,
            },
        )
    return (
        name + suffix,
        png,
        {
            "imageid": name[:-2],
            "sol": image.sol,
            "site": image.stop.site,
            "drive": str(image.stop.drive),
            "attitude": text(pose.quaternion),
            "sample_type": "Full",
            "date_taken_utc": "2023-01-08T03:53:04.187",
            "camera": {**model, "filter_name": "UNK"},
            "extended": {
                "sclk": str(image.clock),
                "xyz": text(pose.translation_m),
                "dimension": f"({image.samples},{image.lines})",
                "subframeRect": part,
                "scaleFactor": "1",
            },
        },
    )


def json_bytes(item: dict) -> bytes:
    return json.dumps(item).encode()
