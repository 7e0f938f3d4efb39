"""Processing of real files: a table of label kind, mission and level.

python -m tests.support.real_files ../shared/data > docs/reference/real-files.md
"""

import sys
from pathlib import Path

from solmap.flows.cli.inspection import InspectionError, inspect_file
from solmap.photogrammetry.archive.images.reading import read_image
from solmap.photogrammetry.archive.partners import find_stereo_pairs
from solmap.photogrammetry.archive.tables.places import parse_localisations
from solmap.photogrammetry.archive.tables.vector_files import parse_vector_file
from solmap.photogrammetry.errors import PhotogrammetryError
from solmap.photogrammetry.imagery import RoverImage
from solmap.tasks.images.files import image_bytes, remedy
from solmap.tasks.images.folders import IMAGE_FILE_SUFFIXES, IMAGE_SUFFIXES, VECTOR_SUFFIXES

HEAD = """# Processing of real files

Archived files of four rovers, of every available kind of label and processing level, and the result
of `solmap run` (images and vector files) or `solmap inspect` (labels alone). `python -m
tests.support.real_files` writes the table, and a test compares this page with it.

| file | label | mission, level | result |
| --- | --- | --- | --- |
"""
SPIRIT, TRAVERSE = "mer_spirit_sol1869_troy", "traverse"
OPPORTUNITY, MSL = "mer_opportunity_sol4084_4090", "msl_navcam_sol1431_pair"
SINGLE = "mer_opportunity_single_frames"
M2020 = "m2020_navcam_single_frames/NLF_0670_0726421423_362ECM_N0320604NCAM08111_01_095J01"
FILES = {
    f"{SPIRIT}/2n292280938effb100p0703l0m1.img": "Spirit EDR",
    f"{SPIRIT}/2n292280989effb100p0703l0m1.img": "Spirit EDR",
    f"{SPIRIT}/2n292280938radb100p0703l0c1.img": "Spirit RDR, radiometric (Cornell)",
    f"{SPIRIT}/2n292280938rslb100p0703l0m1.img": "Spirit RDR, radiometric, linearised",
    "mer_spirit_sol1900/2n295043924fflb1dnp1979l0m1.img": "Spirit RDR, linearised",
    "mer_spirit_sol1900/2p295043688fflb1dnp2380l2m1.img": "Spirit RDR, linearised",
    f"{SPIRIT}/2N292280938FFLB100P0703L0M1.PNG": "Spirit browse image of an RDR",
    "mer_spirit_sol1861_1871_browse/2n292380548fflb159p0691l0m1.img.jpg": (
        "Spirit browse image of an RDR"
    ),
    f"{SPIRIT}/2n292280938xylb100p0703l0m1.lbl": "Spirit RDR, terrain wedge",
    f"{SPIRIT}/2n292280938vilb100p0703l0m1.lbl": "Spirit RDR, terrain mesh",
    "mer_spirit_sol767_label_pair/2n194463440effapa0p0685l0m1.excerpt.lbl": "Spirit EDR, excerpt",
    f"{OPPORTUNITY}/1F490747543EFFCNY9P1214L0M1.IMG": "Opportunity EDR",
    f"{SINGLE}/1F483288473EFFCMUFP1214L0M1.IMG": "Opportunity EDR",
    f"{OPPORTUNITY}/1N491020376ILFCNY9P0706L0M1.IMG": "Opportunity RDR, inverse look-up",
    f"{OPPORTUNITY}/1N491020519ILFCNY9P0706L0M1.IMG": "Opportunity RDR, inverse look-up",
    f"{OPPORTUNITY}/1N491020834ILFCNY9P0706L0M1.IMG": "Opportunity RDR, inverse look-up",
    f"{OPPORTUNITY}/1N491020993ILFCNY9P0706L0M1.IMG": "Opportunity RDR, inverse look-up",
    f"{OPPORTUNITY}/1N491021154ILFCNY9P0706L0M1.IMG": "Opportunity RDR, inverse look-up",
    f"{OPPORTUNITY}/1P491287702ILFCNY9P2584L2M1.IMG": "Opportunity RDR, inverse look-up",
    f"{SINGLE}/1N546228391RADCYELP0684L0M1.IMG": "Opportunity RDR, radiometric",
    f"{SINGLE}/1p216067135edn76pop2102l2m1.img": "Opportunity EDR, averaged sub-frame, altered",
    "msl_navcam_single_frames/NLA_399621413EDR_F0030308NCAM00405M1.IMG": "Curiosity EDR, A side",
    f"{MSL}/NLB_517261274EDR_F0541610CCAM15900M1.IMG": "Curiosity EDR, B side",
    f"{MSL}/NLB_517261274EDR_F0541610CCAM15900M1.LBL": "Curiosity EDR, label beside it",
    f"{MSL}/NRB_680874728RAD_F0900232NCAM00354M1.IMG": "Curiosity RDR, radiometric",
    f"{MSL}/NLB_524534514EDR_F0562034NCAM00280M_.jpeg": "Curiosity public raw image",
    f"{MSL}/NRB_524534514EDR_F0562034NCAM00280M_.jpeg": "Curiosity public raw image",
    "labels/NLA_399620372ARMLD0030266TRAV00004M1.LBL": "Curiosity RDR, reachability",
    f"{M2020}.png": "Perseverance public raw image, tile",
    f"{M2020}-metadata.json": "Perseverance metadata alone",
    "analogue_k10_pair/left4.png": "K10, an analogue rover on Earth",
    f"{TRAVERSE}/mer_spirit/mer2_master.svf": "Spirit, sites",
    f"{TRAVERSE}/mer_spirit/mer2_site_137_master.rvf": "Spirit, stops",
    f"{TRAVERSE}/msl/locations.xml": "Curiosity, localised stops",
}
"""Below the folder of shared data -> mission and level."""


def page(data: Path) -> str:
    """The page about the files of a folder."""
    records = {file: record for file in FILES if (record := _record(data / file)) is not None}
    pairing = find_stereo_pairs(list(records.values()))
    lines = []
    for file, level in FILES.items():
        path = data / file
        record = records.get(file)
        if record is not None:
            outcome = f"image: {_message_of(record)}; {_role(record, pairing.unpaired)}"
        else:
            outcome = _outcome(path)
        lines.append(f"| `{path.name}` | {_label(path)} | {level} | {_cell(outcome)} |")
    return HEAD + "\n".join(lines) + "\n"


def _record(path: Path) -> RoverImage | None:
    """Of an image that is taken, pixels and all."""
    if path.suffix.lower() not in IMAGE_SUFFIXES | IMAGE_FILE_SUFFIXES:
        return None
    try:
        return read_image(image_bytes(path), path.name).image
    except PhotogrammetryError:
        return None


def _message_of(image: RoverImage) -> str:
    kind = f"{type(image.camera).__name__.upper()}{', linearised' * image.is_linearised}"
    eye = f"{image.instrument.replace('_', ' ').lower()} {image.eye}"
    return f"{eye} of sol {image.sol} at {image.stop}, {image.product_type}, {kind}"


def _role(image: RoverImage, unpaired: dict[str, str]) -> str:
    return unpaired.get(image.id, "half of a stereo pair")


def _outcome(path: Path) -> str:
    """The content of a file that is not an image, or why it is refused and what helps."""
    suffix = path.suffix.lower()
    try:
        if suffix in VECTOR_SUFFIXES:
            solutions = parse_vector_file(path.read_text(), path.name).solutions
            return f"poses: {len(solutions)} solutions"
        if path.name == "locations.xml":
            solutions = parse_localisations(path.read_text(), path.name).solutions
            return f"poses: {len(solutions)} positions, by `solmap poses add`"
        if suffix in IMAGE_SUFFIXES | IMAGE_FILE_SUFFIXES:
            read_image(image_bytes(path), path.name)
        else:
            found = inspect_file(path)
            return f"`solmap inspect`: {found.get('product_type') or found.get('kind')}"
    except (PhotogrammetryError, InspectionError) as error:
        line = str(error).replace(f"{path.name}: ", "", 1)
        helps = remedy(path.name)
        return f"refused: {line}{f'; {helps}' if helps and '`solmap ' not in line else ''}"
    raise AssertionError(f"{path.name} is an image")


def _label(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix in {".svf", ".rvf", ".xml"}:
        return "XML"
    if suffix == ".json":
        return "JSON metadata"
    if suffix == ".lbl":
        return "PDS3, alone"
    start = path.read_bytes()[:3].decode("latin-1")
    if start in {"ODL", "PDS"}:
        return f"{'PDS3' if start == 'PDS' else 'ODL'}, attached"
    has_metadata = path.with_name(f"{path.stem}-metadata.json").is_file()
    return "JSON metadata beside it" if has_metadata else "none"


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


if __name__ == "__main__":
    sys.stdout.write(page(Path(sys.argv[1])))
