"""Files that nobody should deliver, beside good pairs: what a run makes of them, and what it takes.

    python -m tests.support.hostile_files FOLDER [--only-write]

writes a small downlink into FOLDER/clean, the same with hostile files beside it into
FOLDER/hostile, takes both into stores of their own with `solmap run`, and prints the differences,
and the time and memory of each. Every hostile file is one that is refused: it must give one line
and change nothing.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import socket
import stat
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import psutil

from solmap.products.store.user_files import plain_name
from tests.support.small_downlink import FEW_LAYERS, write_coarse_pipeline, write_small_downlink
from tests.support.store_checks import Contents

MARKUP = "[/red][link=file:///etc/passwd]"
FORMULA = "=HYPERLINK(0)"
LEFTWARDS = "\u202egmi"
ESCAPE = "\x1b[2J\x1b]0;owned\x07"
DIGITS = "9" * 401
DEEP = 100_000

Made = Iterator[tuple[str, bytes]]


def label_with(image: bytes, *changes: tuple[str, str | None]) -> bytes:
    """An image whose label has other values: `KEYWORD`, or `OBJECT/KEYWORD`; None: without it."""
    end = image.index(b"\nEND\r\n") + len(b"\nEND\r\n")
    text, pixels = image[:end].decode("latin-1"), image[41 * 512 :]
    for path, value in changes:
        group, _, keyword = path.rpartition("/")
        start = re.search(rf"(?:GROUP|OBJECT)\s*= {group}\b", text).start() if group else 0
        line = re.compile(rf"^[ ]*{re.escape(keyword)}\s*=[^=]*(?=\r\n\s*[\^A-Z/])", re.MULTILINE)
        found = line.search(text, start)
        assert found, path
        new = "" if value is None else f"{keyword} = {value}"
        text = text[: found.start()] + new + text[found.end() :]
    label = text.encode("latin-1", "replace")
    records = max(41, -(-len(label) // 512))
    if records > 41 and not any(path == "^IMAGE" for path, _ in changes):
        return label_with(
            image[:end].ljust(41 * 512) + pixels, *changes, ("^IMAGE", str(records + 1))
        )
    return label.ljust(records * 512) + pixels


ROVER = "ROVER_COORDINATE_SYSTEM"
NUMBERS = ("UNK", '""', "(1,2)", '"x"', "-1", "1E999", "9" * 38, f'"{MARKUP}"', None)
VECTORS = ("UNK", "7", "(1,2)", "(1,2,3,4,5)", "(NULL,0,0)", "(1E999,0,0)", "(1e12,0,0)", None)
FIELDS: dict[str, Sequence[str | None]] = {
    "INSTRUMENT_HOST_ID": ("UNK", '"CASSINI"', '"MSL"', "7", f'"{MARKUP}"', '"MER2\x00"', None),
    "INSTRUMENT_ID": ("UNK", '"NAVCAM"', '"../NAVCAM_LEFT"', "(1,2)", f'"{ESCAPE}"', None),
    "PLANET_DAY_NUMBER": (*NUMBERS, "100001", "1.5"),
    "SPACECRAFT_CLOCK_START_COUNT": (*NUMBERS, '"1/nan"', '"inf"', "5000000000"),
    "ROVER_MOTION_COUNTER": ("UNK", "7", "(10)", "(10,-1)", "(10,0.5)", "(1E30,0)", '"x"', None),
    "IMAGE/LINES": (*NUMBERS, "0", "65536", "4000000000"),
    "IMAGE/LINE_SAMPLES": (*NUMBERS, "0", "65536"),
    "IMAGE/BANDS": ("7", "-1", "1E999", '"x"', "(1,2)"),
    "IMAGE/SAMPLE_BITS": ("UNK", "12", "-16", '"x"', "1E999", None),
    "IMAGE/SAMPLE_TYPE": ("UNK", '"COMPLEX"', f'"{MARKUP}"', "(1,2)", None),
    "^IMAGE": ("UNK", "0", "-5", "1E12", "9" * 38, "()", None),
    "IMAGE_TYPE": ("THUMBNAIL", f'"{LEFTWARDS}"', "(1,2)"),
    "GEOMETRIC_CAMERA_MODEL/MODEL_TYPE": ("UNK", '"FISHEYE"', f'"{MARKUP}"', "7", None),
    "GEOMETRIC_CAMERA_MODEL/MODEL_COMPONENT_1": VECTORS,
    "GEOMETRIC_CAMERA_MODEL/MODEL_COMPONENT_2": (*VECTORS, "(0,0,0)", "(2,0,0)"),
    "GEOMETRIC_CAMERA_MODEL/MODEL_COMPONENT_3": (*VECTORS, "(0,0,0)"),
    "GEOMETRIC_CAMERA_MODEL/MODEL_COMPONENT_4": (*VECTORS, "(0,0,0)", "(1e-9,2e-9,1e-9)"),
    "GEOMETRIC_CAMERA_MODEL/MODEL_COMPONENT_5": (*VECTORS, "(0,0,0)"),
    "GEOMETRIC_CAMERA_MODEL/REFERENCE_COORD_SYSTEM_NAME": ('"LANDER_FRAME"', f'"{ESCAPE}"'),
    f"{ROVER}/ORIGIN_OFFSET_VECTOR": (*VECTORS, "(100001,0,0)"),
    f"{ROVER}/ORIGIN_ROTATION_QUATERNION": (
        *("UNK", "(1,0,0)", "(0,0,0,0)", "(NULL,0,0,0)", "(1E999,0,0,0)"),
        *("(0.5,0,0,0)", "(2,0,0,0)", "(1e-200,0,0,0)", '"x"', None),
    ),
    f"{ROVER}/REFERENCE_COORD_SYSTEM_NAME": ('"MARS"', f'"{MARKUP}"'),
    "SEQUENCE_ID": ('"a\x00b"', '"' + "q" * 200 + '"', "(1,2)"),
    "SITE_DERIVED_GEOMETRY_PARMS/SOLAR_ELEVATION": ("1E30 <deg>", '"x"', "1E999"),
}
"""Keyword -> values that no image can have."""


def damaged_labels(image: bytes) -> Made:
    """The good image with one impossible value, under a name of its own."""
    for field, values in FIELDS.items():
        for number, value in enumerate(values):
            yield (
                f"{field.rpartition('/')[2].strip('^').lower()}-{number}",
                label_with(image, (field, value)),
            )


def cut_off(image: bytes) -> Made:
    """The good image cut off at the borders of its parts."""
    size, label = len(image), 41 * 512
    for at in (
        0,
        1,
        14,
        100,
        511,
        512,
        513,
        5000,
        label - 1,
        label,
        label + 1,
        size // 2,
        size - 1,
    ):
        yield f"cut-{at:06d}", image[:at]
    yield "begins-late", image[1:]
    yield "label-twice", image[:5000] + image[:label]
    yield "zeros", bytes(len(image))
    yield "all-missing", image[:label] + bytes(size - label)
    yield "noise", np.random.default_rng(7).bytes(9000)
    yield "unclosed-comment", b"PDS_VERSION_ID = PDS3 A = (" + b"/* " * 300_000
    yield "lists-in-lists", b"PDS_VERSION_ID = PDS3 A = " + b"(" * DEEP
    yield "groups-in-groups", b"PDS_VERSION_ID = PDS3 " + b"GROUP = A " * DEEP
    yield "many-words", b"PDS_VERSION_ID = PDS3 " + b"A = 1 " * DEEP
    yield "no-end", image[:10_000].replace(b"END_", b"EMD_")
    raster = "DERIVED_IMAGE_PARMS\r\n DERIVED_IMAGE_TYPE = XYZ_MAP\r\nEND_GROUP"
    yield "raster", image.replace(b"/* POINTERS", f"GROUP = {raster}\r\n/*".encode(), 1)


def vicar_files() -> Made:
    """VICAR labels that state more data than there is."""
    for number, items in enumerate(
        (
            b"",
            b"FORMAT='HALF' NL=1 NS=1",
            b"FORMAT='COMP' NL=4 NS=5",
            b"FORMAT='HALF' NL=-4 NS=5",
            b"FORMAT='BYTE' NL=99999 NS=99999 NB=1",
            b"FORMAT='HALF' NL=4 NS=5 EOL=1 RECSIZE=1 N2=1 N3=1",
            b"FORMAT='HALF' NL=4 NS=5 EOL=1 RECSIZE=999999999999 N2=9 N3=9 NLB=9",
            b"FORMAT='HALF' A=(" + b"''" * 50_000,
            b"FORMAT='HALF' " + b"A=1 " * 100_000,
        )
    ):
        yield f"vicar-{number}", b"LBLSIZE=%d " % (len(items) + 40) + items.ljust(len(items) + 90)
    yield "vicar-huge", b"LBLSIZE=99999999 FORMAT='BYTE'"


VALID_METADATA = {
    "imageid": "NLF_0001_0667000000_000ECM_N0030001NCAM00001_01_095J01",
    "sol": 1,
    "instrument": "NAVCAM_LEFT",
    "sclk": 667000000.5,
    "dimension": "(3,2)",
    "site": 3,
    "drive": 2,
    "xyz": "(1,2,3)",
    "attitude": "(1,0,0,0)",
    "camera_model_type": "CAHVOR",
    "camera_model_component_list": "(1,0,-2);(1,0,0);(9,9,0);(9,0,9);(1,0,0);(0,0,0)",
}
METADATA: dict[str, Sequence[object]] = {
    "imageid": (
        "A\x00B",
        "\ud800",
        "/.",
        "../../..",
        "A" * 5000,
        LEFTWARDS,
        ESCAPE,
        MARKUP,
    ),
    "sol": (int("9" * 38), -1, "x", None, 1.5, 100_001, [1], {"a": 1}),
    "sclk": (int("9" * 400), None, "x", float("nan"), float("inf"), -5, 5_000_000_000, [1]),
    "instrument": (MARKUP, None, 7, ["NAVCAM_LEFT"]),
    "dimension": ("(0,0)", "(-3,2)", "(1e300,1e300)", "(99999,99999)", "x", None, [1, 2, 3]),
    "site": (int("9" * 38), -1, "../3", 100_000_000),
    "xyz": ("(1e12,0,0)", "(nan,0,0)", "()", None, [1, "x", 3]),
    "attitude": ("(0,0,0,0)", "(9,9,9,9)", "(nan,0,0,0)", None, "x"),
    "camera_model_type": ("", MARKUP, ["CAHV"], {}),
    "camera_model_component_list": (
        *("", ";;;;;", "(1e300,0,0);(1,0,0);(9,9,0);(9,0,9);(1,0,0);(0,0,0)"),
        *("(1,0,0);(0,0,0);(0,0,0);(0,0,0);(0,0,0);(0,0,0)", 7),
    ),
}
"""Key of the metadata of a raw image of Mars 2020 -> values that it cannot have."""


def images(folder: Path) -> Iterator[str]:
    """Images whose metadata, or whose own headers, are wrong."""
    grey = cv2.imencode(".png", np.full((2, 3), 7, np.uint8))[1].tobytes()
    for key, values in METADATA.items():
        for number, value in enumerate(values):
            name = f"m2020-{key}-{number}"
            metadata = json.dumps({**VALID_METADATA, "imageid": name, key: value})
            (folder / f"{name}.json").write_text(metadata)
            yield _write(folder / f"{name}.png", grey)
    for number, text in enumerate(
        (
            "[" * DEEP,
            '{"a":' * DEEP,
            "[]",
            '{"sol": ' + DIGITS * 20 + "}",
            "{",
            '{"a": "' + "x" * 900_000,
        )
    ):
        (folder / f"m2020-json-{number}.json").write_text(text)
        yield _write(folder / f"m2020-json-{number}.png", grey)
    big = _png_header(30_000, 30_000, 8)
    bombs = {
        "wide": (big, "(30000,30000)"),
        "wider-than-stated": (big, "(3,2)"),
        "deep-colours": (_png_header(5000, 5000, 16), "(5000,5000)"),
        "empty": (_png_header(5000, 5000, 8), "(5000,5000)"),
        "cut": (grey[:40], "(3,2)"),
        "nothing": (_png_header(0, 0, 8), "(1,1)"),
        "scans": (_jpeg() + b"\xff\xda\x00\x08" * 500, "(40,40)"),
        "large-jpeg": (_jpeg().replace(b"\x00\x28\x00\x28", b"\xff\xff\xff\xff"), "(65535,65535)"),
        "black": (
            cv2.imencode(".png", np.zeros((5000, 5000), np.uint8))[1].tobytes(),
            "(5000,5000)",
        ),
    }
    for name, (data, size) in bombs.items():
        metadata = json.dumps({**VALID_METADATA, "imageid": f"BOMB-{name}", "dimension": size})
        (folder / f"bomb-{name}.json").write_text(metadata)
        yield _write(folder / f"bomb-{name}.png", data)
    yield _write(folder / "without-metadata.png", grey)
    yield _write(folder / "nonsense.jpg", b"\xff\xd8\xff" + b"\xff" * 5000)


def _png_header(samples: int, lines: int, bits: int) -> bytes:
    head = b"IHDR" + samples.to_bytes(4) + lines.to_bytes(4) + bytes((bits, 0, 0, 0, 0))
    import zlib  # noqa: PLC0415 - only here

    data = zlib.compress(bytes(1 << 20), 9)
    parts = [(13, head), (len(data), b"IDAT" + data), (0, b"IEND")]
    body = b"".join(n.to_bytes(4) + part + zlib.crc32(part).to_bytes(4) for n, part in parts)
    return b"\x89PNG\r\n\x1a\n" + body


def _jpeg() -> bytes:
    return cv2.imencode(".jpg", np.full((40, 40), 7, np.uint8))[1].tobytes()


def pds4_files(folder: Path) -> Iterator[str]:
    """Data with XML labels that are deep, wide, or none."""
    head = (
        "<Product_Observational><logical_identifier>mars2020</logical_identifier><Geometry_Lander>"
    )
    tail = "</Geometry_Lander></Product_Observational>"
    space = "Coordinate_Space_Definition"
    count = (1 << 20) // (2 * len(space) + 8)
    for number, text in enumerate(
        (
            head + f"<{space}>" * count + f"</{space}>" * count + tail,
            head + f"<{space}>" * 25 + "<a/>" * 200_000 + f"</{space}>" * 25 + tail,
            head + f"<{space}/>" * (900_000 // len(space)) + tail,
            '<!DOCTYPE a [<!ENTITY b "c">]><Product_Observational>&b;</Product_Observational>',
            '<!DOCTYPE a SYSTEM "file:///etc/passwd"><Product_Observational/>',
            "<Product_Observational>",
            "<html/>",
            "<" * 100_000,
            head + f"<a b='{'x' * 900_000}'/>" + tail,
            "<?xml version='1.0' encoding='utf-16'?><a/>",
        )
    ):
        (folder / f"pds4-{number}.xml").write_text(text)
        yield _write(folder / f"pds4-{number}.img", bytes(range(200)))


SOLUTION = (
    '<solution solution_id="telemetry" name="{name}" {index}>'
    '<reference_frame name="SITE_FRAME" index1="{site}"/>'
    '<offset x="{x}" y="0" z="0"/><orientation s="{s}" v1="0" v2="0" v3="0"/></solution>'
)


def _vectors(body: str) -> bytes:
    return f'<rmc_file mission="MER2" variant="x">{body}</rmc_file>'.encode("utf-8", "replace")


def _solution(
    name: str = "SITE_FRAME", index: str = 'index1="5"', site: str = "4", x: str = "1", s: str = "1"
) -> str:
    return SOLUTION.format(name=name, index=index, site=site, x=x, s=s)


def vector_files() -> Made:
    """Site and rover vector files that place nothing."""
    priorities = "".join(f'<entry solution_id="s{k}"/>' for k in range(60_000))
    for number, data in enumerate(
        (
            b"",
            b"not XML",
            b"\xff\xfe\x00",
            b"<rmc_file><solution></rmc_file>",
            b"<rmc_file mission='M'>" + b"<a>" * DEEP,
            b'<!DOCTYPE a [<!ENTITY b "c">]><rmc_file mission="M">&b;</rmc_file>',
            _vectors(""),
            _vectors(_solution(x="1e12")),
            _vectors(_solution(x="nan")),
            _vectors(_solution(x="1e999")),
            _vectors(_solution(x=DIGITS)),
            _vectors(_solution(s="0")),
            _vectors(_solution(s="5")),
            _vectors(_solution(site="5")),
            _vectors(_solution(site=DIGITS)),
            _vectors(_solution(index=f'index1="{DIGITS}"')),
            _vectors(_solution(index='index1="-1"')),
            _vectors(_solution(index="")),
            _vectors(_solution(name="MARS")),
            _vectors(_solution(name=MARKUP.replace("[", "(")[:20])),
            _vectors(_solution("ROVER_FRAME", 'index1="5"')),
            _vectors(f"<priority>{priorities}</priority>" + _solution()),
            _vectors(_solution() * 30_000),
            _vectors(_solution()).replace(b"MER2", b'">&'),
        )
    ):
        yield f"vectors-{number}.svf" if number % 2 else f"vectors-{number}.rvf", data


HEAD = "action,first_image,first_sample,first_line,second_image,second_sample,second_line,sigma_px"


def manual_ties() -> Made:
    """Files of manual ties that cannot be carried out."""
    good = {
        "action": "add",
        "first_image": "A",
        "first_sample": 1,
        "first_line": 1,
        "second_image": "B",
        "second_sample": 1,
        "second_line": 1,
    }

    def features(**changed: object) -> bytes:
        row = {"properties": {**good, **changed}, "geometry": None}
        return json.dumps({"type": "FeatureCollection", "features": [row]}).encode()

    for number, data in enumerate(
        (
            features(sigma_px=int("9" * 401)),
            features(sigma_px=-1),
            features(sigma_px=float("nan")),
            features(sigma_px=float("inf")),
            features(sigma_px=[1]),
            features(sigma_px=True),
            features(first_sample=1e300),
            features(first_image="\ud800"),
            features(first_image="A\x00"),
            features(first_image=LEFTWARDS),
            features(first_image="A" * 5000),
            features(action=FORMULA),
            features(action=MARKUP),
            features(**{ESCAPE: 1}),
            b'{"features": ' + b"[" * DEEP,
            b'{"features": 7}',
            b'{"features": [{"properties": null}]}',
            b"{",
        )
    ):
        yield f"ties-{number}.ties.geojson", data
    for number, text in enumerate(
        (
            f"{HEAD}\nadd,A,1,1,B,1,1,{DIGITS}",
            f"{HEAD}\nadd,A,1,1,B,1,1,0",
            f"{HEAD}\nadd,A,1,1,A,1,1,1",
            f"{HEAD}\n{FORMULA},A,1,1,B,1,1,1",
            f'{HEAD}\n"add,A',
            f"{HEAD}\nadd" + ",x" * 5000,
            f"{MARKUP},{ESCAPE}\n",
            "x" * 200_000,
            f"{HEAD}\n" + "add,A,1,1,B,1,1,1\n" * 300_000,
        )
    ):
        yield f"rows-{number}.ties.csv", text.encode()
    yield "latin.ties.csv", HEAD.encode() + b"\nadd,\xff,1,1,B,1,1,1"


NAMES = (
    b"\xff\xfe\x80.img",
    b"caf\xe9.svf",
    b"\xed\xa0\x80.ties.csv",
    b"two\nlines.img",
    b"back\rover.img",
    b"tab\there.img",
    ESCAPE.encode() + b".img",
    b"\x7f\x08\x08.img",
    "\u0085\u2028\u200b.img".encode(),
    f"{LEFTWARDS}.img".encode(),
    b"[red]bold[bold].img",
    b"[link=http:].img",
    FORMULA.encode() + b".img",
    b"+1-1.img",
    b"@SUM(1).img",
    b"-rf.img",
    b"--store=x.img",
    b"%s%n%d.img",
    b"{downlink}{0.__class__}.img",
    b"$(reboot).img",
    b"`reboot`;.img",
    b"'\";--.img",
    b"back\\slash.img",
    b"<script>.img",
    b"&amp;.img",
    b".hidden.img",
    b"...img",
    b" .img",
    b"x.img.IMG",
    b"n" * 251 + b".img",
    b"m" * 251 + b".png",
    ("\u6f22" * 83).encode() + b".img",
    b"CON.img",
    b"spaced  name .img",
)


def odd_names(folder: Path) -> Iterator[str]:
    """Names that are hard to print, keep and send, of files that hold nothing."""
    here = os.fsencode(folder)
    for name in NAMES:
        Path(os.fsdecode(here + b"/" + name)).write_bytes(b"nothing that is an image")
        yield os.fsdecode(name)


def no_files(folder: Path, outside: Path) -> Iterator[str]:
    """FIFOs, sockets, devices, and links that lead somewhere else."""
    for name in ("fifo.img", "fifo-b.png", "fifo.svf", "fifo.ties.csv"):
        os.mkfifo(folder / name)
        yield name
    here = Path.cwd()
    os.chdir(folder)  # the name of a socket has at most 107 bytes
    try:
        for name in ("socket.img", "socket.svf"):
            with socket.socket(socket.AF_UNIX) as one:
                one.bind(name)
            yield name
    finally:
        os.chdir(here)
    devices = {"null": (1, 3), "zero": (1, 5), "random": (1, 8), "kmsg": (1, 11), "tty": (5, 0)}
    for kind, numbers in devices.items():
        try:
            os.mknod(folder / f"device-{kind}.img", stat.S_IFCHR | 0o600, os.makedev(*numbers))
        except OSError:
            continue  # only root makes devices
        yield f"device-{kind}.img"
    outside.mkdir(exist_ok=True)
    (outside / "secret.img").write_bytes(b"PDS_VERSION_ID = PDS3 SECRET = 1 END")
    (outside / "secret.lbl").write_bytes(b"PDS_VERSION_ID = PDS3 SECRET = 1 END")
    targets = {
        "kmsg.img": "/proc/kmsg",
        "kcore.img": "/proc/kcore",
        "zero.img": "/dev/zero",
        "stdin.img": "/dev/stdin",
        "passwd.svf": "/etc/passwd",
        "shadow.ties.csv": "/etc/shadow",
        "environment.img": "/proc/self/environ",
        "outside.img": str(outside / "secret.img"),
        "outside-b.png": f"../../{outside.name}/secret.img",
        "nowhere.img": "gone.img",
        "itself.img": "itself.img",
        "circle-a.img": "circle-b.img",
        "circle-b.img": "circle-a.img",
        "to-fifo.img": "fifo.img",
        "chain.img": "outside.img",
    }
    for name, target in targets.items():
        (folder / name).symlink_to(target)
        yield name
    (folder / "label-outside.png").write_bytes(_jpeg())
    (folder / "label-outside.lbl").symlink_to(outside / "secret.lbl")
    yield "label-outside.png"


def giants(folder: Path, image: bytes) -> Iterator[str]:
    """Files that take hardly any disk and would take all memory."""
    for name, samples, size in (
        ("sparse-a.img", 11_500, 255 << 20),
        ("sparse-b.img", 11_500, 255 << 20),
        ("sparse-c.img", 5_700, 80 << 20),
        ("sparse-large.img", 30_000, 200 << 30),
    ):
        sizes = tuple((f"IMAGE/{word}", str(samples)) for word in ("LINES", "LINE_SAMPLES"))
        yield _write(folder / name, label_with(image, *sizes)[: 41 * 512])
        os.truncate(folder / name, size)
    for name in ("sparse.svf", "sparse.ties.csv", "sparse.png", "unlabelled.img"):
        yield _write(folder / name, b"")
        os.truncate(folder / name, 1 << 30 if name != "unlabelled.img" else 255 << 20)


def _write(path: Path, data: bytes) -> str:
    path.write_bytes(data)
    return path.name


def write_hostile_files(downlink: Path) -> list[str]:
    """Write them below a downlink with good pairs; the names of those that must be refused."""
    image = min(downlink.rglob("*l0m1.img")).read_bytes()
    folder = downlink / "hostile"
    folder.mkdir()
    names: list[str] = []
    for number, (name, data) in enumerate(
        (*damaged_labels(image), *cut_off(image), *vicar_files())
    ):
        names.append(_write(folder / f"{name}-{number:03d}.img", data))
    names += [_write(folder / name, data) for name, data in (*vector_files(), *manual_ties())]
    names += images(folder)
    names += pds4_files(folder)
    names += odd_names(folder)
    names += no_files(folder, downlink.with_name(f"{downlink.name}-outside"))
    names += giants(folder, image)
    deep = folder
    for _ in range(100):
        deep = deep / "deeper"
        deep.mkdir()
    names.append(_write(deep / "deepest.img", b"nothing"))
    return [plain_name(name) for name in names]


@dataclass(frozen=True)
class Ran:
    """A run of a downlink."""

    lines: tuple[str, ...]
    """What it printed."""
    code: int
    seconds: float
    peak_bytes: int
    """Most memory of all its processes together, resident."""
    contents: Contents


def run(downlink: Path, store: Path, *, pipeline: str = FEW_LAYERS) -> Ran:
    """Take a downlink with `solmap run` in processes of its own, and look at their memory."""
    recipe = write_coarse_pipeline(store.with_suffix(".toml"), pipeline)
    printed = store.with_suffix(".log")
    command = [sys.executable, "-m", "solmap.flows.cli", "run", str(downlink)]
    began, peak = time.monotonic(), 0
    with printed.open("wb") as log:
        process = subprocess.Popen(
            [*command, "--store", str(store), "--pipeline", str(recipe)],
            stdout=log,
            stderr=subprocess.STDOUT,
            env={**os.environ, "COLUMNS": "2000"},
        )
        while process.poll() is None:
            peak = max(peak, _resident(process.pid))
            time.sleep(0.05)
    seconds = time.monotonic() - began
    lines = printed.read_text("utf-8", "replace").splitlines()
    return Ran(tuple(lines), process.returncode, seconds, peak, Contents.of(store))


def _resident(pid: int) -> int:
    total = 0
    try:
        tree = [psutil.Process(pid), *psutil.Process(pid).children(recursive=True)]
    except psutil.Error:
        return 0
    for one in tree:
        try:
            total += one.memory_info().rss
        except psutil.Error:
            continue
    return total


def messages(ran: Ran, names: Sequence[str]) -> dict[str, int]:
    """How many lines name each file as the one that they are about."""
    lines = [line.removeprefix("warning ") for line in ran.lines if line.startswith("warning ")]
    shown = {name: " ".join(name.split()) for name in names}
    return {
        name: sum(line.startswith((f"{plain}:", f"{plain},")) for line in lines)
        for name, plain in shown.items()
    }


def compare(folder: Path) -> tuple[Ran, Ran, list[str]]:
    """Run a downlink without and with hostile files; what is wrong, a line each."""
    clean, hostile = folder / "clean", folder / "hostile"
    write_small_downlink(clean)
    shutil.copytree(clean, hostile)
    names = write_hostile_files(hostile)
    first, second = run(clean, folder / "clean-store"), run(hostile, folder / "hostile-store")
    wrong = [
        f"{name}: {count} lines"
        for name, count in messages(second, names).items()
        if count != names.count(name)
    ]
    wrong += [f"unexpected: {line}" for line in second.lines if "Traceback" in line]
    products = {
        f"{name}: {what}"
        for what, one, other in (("lost", first, second), ("more", second, first))
        for name, digest in one.contents.products.items()
        if other.contents.products.get(name) != digest
    }
    rows = [
        f"{table}/{key} differs"
        for table in ("missions", "images", "layers", "latest")
        for key in first.contents.rows[table].keys() | second.contents.rows[table].keys()
        if first.contents.rows[table].get(key) != second.contents.rows[table].get(key)
    ]
    return first, second, [*wrong, *sorted(products), *sorted(rows)]


def main() -> None:
    """Compare both runs, or only write the files."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only-write", action="store_true")
    requested = parser.parse_args()
    requested.folder.mkdir(parents=True, exist_ok=True)
    if requested.only_write:
        write_small_downlink(requested.folder)
        sys.stdout.write(f"{len(write_hostile_files(requested.folder))} hostile files\n")
        return
    first, second, wrong = compare(requested.folder)
    for name, ran in (("clean", first), ("hostile", second)):
        sys.stdout.write(
            f"{name}: {ran.seconds:.0f} s, {ran.peak_bytes >> 20} MiB, exit {ran.code}, "
            f"{len(ran.lines)} lines, {len(ran.contents.products)} products\n"
        )
    sys.stdout.write("\n".join([*wrong, f"{len(wrong)} differences"]) + "\n")


if __name__ == "__main__":
    main()
