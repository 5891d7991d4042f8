"""Hostile depth: PNG images, masks, cameras.json and point clouds."""

from __future__ import annotations

import io
import random
import struct
import zlib
from functools import cache
from typing import Any

import numpy as np
from PIL import Image

from hostile.case import CONTROL, MISSING_HAND, Content, Draw, Hole, Hostile, Link, Pipe, as_content
from hostile.mutations import changed_number, damaged_bytes, damaged_json

SIDE = 60  # points of a cloud along each side of a table
WIDTH, HEIGHT, HIGH = 48, 36, 0.5  # pixels; [m] of the camera over the table
POSE = [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, HIGH], [0, 0, 0, 1]]  # looks straight down
CAMERA = {"depth": "depth.png", "depth_unit": 0.0001, "width": WIDTH, "height": HEIGHT, "fx": 60.0, "fy": 60.0,
          "cx": 23.5, "cy": 17.5, "T_world_camera": POSE, "mask": "mask.png"}  # fmt: skip
SCENE = ("--motion", "1", "0", "0", "--hand", MISSING_HAND, "--out", "out")
PCD = (
    "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {0}\nHEIGHT 1\n"
    "VIEWPOINT 0 0 0.5 1 0 0 0\nPOINTS {0}\nDATA {1}\n"
)


@cache
def depth() -> bytes:
    """Return a depth image of a box, 20 mm high, on a table."""
    steps = np.full((HEIGHT, WIDTH), HIGH / CAMERA["depth_unit"])  # type: ignore[operator]
    steps[12:24, 16:32] -= 0.02 / CAMERA["depth_unit"]  # type: ignore[operator]
    return png(steps.astype(np.uint16))


@cache
def mask() -> bytes:
    """Return the mask of the box."""
    pixels = np.zeros((HEIGHT, WIDTH), np.uint8)
    pixels[12:24, 16:32] = 255
    return png(pixels)


def png(pixels: np.ndarray) -> bytes:
    """Return an image as PNG."""
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "PNG")
    return file.getvalue()


def raw_png(width: int, height: int, *chunks: tuple[bytes, bytes], bits: int = 16, colour: int = 0) -> bytes:
    """Return a PNG of these chunks, with right check sums."""
    head = (b"IHDR", struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0))
    packed = (struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
              for name, data in (head, *chunks, (b"IEND", b"")))  # fmt: skip
    return b"\x89PNG\r\n\x1a\n" + b"".join(packed)


def npy(array: np.ndarray) -> bytes:
    """Return an array as NPY."""
    file = io.BytesIO()
    np.save(file, array, allow_pickle=True)
    return file.getvalue()


def npy_header(text: str) -> bytes:
    """Return an NPY whose header is this text, followed by few numbers."""
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode() + bytes(240)


@cache
def points() -> np.ndarray:
    """Return points of a table, float32."""
    x, y = np.meshgrid(np.linspace(-0.2, 0.2, SIDE), np.linspace(-0.2, 0.2, SIDE))
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1).astype(np.float32)


@cache
def cloud(kind: str) -> bytes:
    """Return the points as a file."""
    if kind == "npy":
        return npy(points())
    if kind == "ply":
        rows = "\n".join(f"{x:.4f} {y:.4f} {z:.4f}" for x, y, z in points())
        head = f"ply\nformat ascii 1.0\nelement vertex {len(points())}\nproperty float x\nproperty float y\nproperty float z\n"
        return f"{head}end_header\n{rows}\n".encode()
    return PCD.format(len(points()), "binary").encode() + points().tobytes()


def views_case(name: str, cameras: Any, expected: Any = "either", says: str = "", **files: Content) -> Hostile:
    """Return the case of a folder of depth images; `depth`, `mask` take the place of the valid files."""
    data = as_content(cameras)
    images = {"views/depth.png": files.get("depth", depth()), "views/mask.png": files.get("mask", mask())}
    arguments = ("scene", "masked", "--depth", "views", *SCENE)
    return Hostile("depth", name, {"views/cameras.json": data, **images}, arguments, expected, says)


def cloud_case(kind: str, name: str, data: Content, expected: Any = "either", says: str = "") -> Hostile:
    """Return the case of a point cloud as surroundings."""
    files = {f"cloud.{kind}": data, "pose.json": b"[[1,0,0,0],[0,1,0,0],[0,0,1,0.004],[0,0,0,1]]"}
    arguments = ("scene", "phone", "--depth", f"cloud.{kind}", "--object-pose", "pose.json", *SCENE)
    return Hostile(f"cloud {kind}", name, files, arguments, expected, says)


def _views(rng: random.Random) -> Hostile:
    which = rng.choice(("cameras", "cameras", "depth", "mask"))
    if which == "cameras":
        return views_case(*damaged_json([CAMERA], rng))
    what, data = damaged_bytes({"depth": depth, "mask": mask}[which](), rng)
    return views_case(f"{which}: {what}", [CAMERA], **{which: data})


def _cloud(kind: str) -> Draw:
    def draw(rng: random.Random) -> Hostile:
        data = cloud(kind)
        if kind != "ply" and rng.random() < 0.5:
            size = 200 if kind == "pcd" else 110
            return cloud_case(kind, "the header's number", changed_number(data[:size], rng) + data[size:])
        return cloud_case(kind, *damaged_bytes(data, rng))

    return draw


def _camera(**changes: Any) -> list[Any]:
    return [CAMERA | changes]


def _pcd(**changes: str) -> bytes:
    lines = PCD.format(SIDE**2, "binary").splitlines()
    lines = [f"{key} {changes[key]}" if (key := line.split()[0]) in changes else line for line in lines]
    return "\n".join([*lines, ""]).encode() + points().tobytes()


ROWS = zlib.compress(b"\0" * (1 + 2 * WIDTH) * HEIGHT)
CAMERAS = {
    "valid": (_camera(), "accepted", ""),
    "empty list": ([], "refused", "views"),
    "an object": (CAMERA, "refused", "list"),
    "a pipe": (Pipe(), "refused", ""),
    "10,000 views": ([CAMERA] * 10_000, "refused", "views"),
    "a number for a view": ([1], "refused", ""),
    "a width of 0": (_camera(width=0), "refused", "width"),
    "a width of 1e300": (_camera(width=1e300), "refused", "pixels"),
    "a width of 10^400": (_camera(width=10**400), "refused", ""),
    "a width of true": (_camera(width=True), "refused", "width"),
    "a focal length of 0": (_camera(fx=0), "refused", "fx"),
    "a focal length of -1": (_camera(fx=-60), "refused", "fx"),
    "a focal length of 1e-300": (_camera(fx=1e-300), "refused", "fx"),
    "a focal length of NaN": (_camera(fx=float("nan")), "refused", ""),
    "a focal length of 1e300": (_camera(fx=1e300, fy=1e300), "refused", ""),
    "a centre 1e300 away": (_camera(cx=1e300), "refused", ""),
    "a centre 1e6 away": (_camera(cx=1e6), "either", ""),
    "a unit of 1 m": (_camera(depth_unit=1.0), "refused", ""),
    "a unit of 0": (_camera(depth_unit=0), "refused", "depth_unit"),
    "a unit of 1e300": (_camera(depth_unit=1e300), "refused", "depth_unit"),
    "a pose of 1e300": (_camera(T_world_camera=[*POSE[:3], [0, 0, 0, 1e300]]), "refused", "T_world_camera"),
    "a pose 1e12 m away": (_camera(T_world_camera=[[1, 0, 0, 1e12], *POSE[1:]]), "refused", ""),
    "a pose of text": (_camera(T_world_camera="here"), "refused", "T_world_camera"),
    "a pose nested 900 deep": (as_content(_camera())[:-2] + b', "T_world_camera2": ' + b"[" * 900 + b"]" * 900 + b"}]", "either", ""),
    "a deep pose": (as_content(_camera(T_world_camera=0)).replace(b'camera": 0', b'camera": ' + b"[" * 900 + b"]" * 900), "refused", ""),
    "an image outside": (_camera(depth="../../../../etc/passwd"), "refused", "outside"),
    "an image at an absolute path": (_camera(depth="/etc/passwd"), "refused", "outside"),
    "an image's name of control characters": (_camera(depth=CONTROL), "refused", ""),
    "an image's name of 300 letters": (_camera(depth="a" * 300), "refused", ""),
    "an image's name is a number": (_camera(depth=5), "refused", "depth"),
    "a mask outside": (_camera(mask="../../../../etc/passwd"), "refused", "outside"),
}  # fmt: skip
IMAGES: dict[str, Content] = {
    "of 1e9 x 1e9": raw_png(10**9, 10**9, (b"IDAT", ROWS)),
    "of no rows": raw_png(WIDTH, HEIGHT, (b"IDAT", zlib.compress(b""))),
    "of half the rows": raw_png(WIDTH, HEIGHT, (b"IDAT", zlib.compress(b"\0" * (1 + 2 * WIDTH) * (HEIGHT // 2)))),
    "of 8 bits": raw_png(WIDTH, HEIGHT, (b"IDAT", ROWS), bits=8),
    "of 3 bits": raw_png(WIDTH, HEIGHT, (b"IDAT", ROWS), bits=3),
    "of colour 9": raw_png(WIDTH, HEIGHT, (b"IDAT", ROWS), colour=9),
    "of zeros": raw_png(WIDTH, HEIGHT, (b"IDAT", ROWS)),
    "with its size twice": raw_png(WIDTH, HEIGHT, (b"IHDR", struct.pack(">IIBBBBB", 9, 9, 16, 0, 0, 0, 0)), (b"IDAT", ROWS)),
    "with a text of 1 GB": raw_png(WIDTH, HEIGHT, (b"zTXt", b"a\0\0" + zlib.compress(bytes(2**27) * 2)), (b"IDAT", ROWS)),
    "of a filter that is none": raw_png(WIDTH, HEIGHT, (b"IDAT", zlib.compress(b"\x09" * (1 + 2 * WIDTH) * HEIGHT))),
    "that is a JPEG": b"\xff\xd8\xff\xe0" + bytes(100),
    "that is a device": Link("/dev/zero"),
    "that is a pipe": Pipe(),
    "that leads outside": Link("../../../../../../etc/passwd"),
    "that is empty": b"",
}  # fmt: skip
NPY = {
    "NaN": npy(np.where(np.arange(3 * SIDE**2).reshape(-1, 3) == 7, np.nan, points())),
    "objects": npy(np.array([{"a": 1}], dtype=object)),
    "text": npy(np.array([["a", "b", "c"]])),
    "complex numbers": npy(points().astype(complex)),
    "truth values": npy(points() > 0),
    "2 columns": npy(points()[:, :2]),
    "no points": npy(points()[:0]),
    "1e300 m": npy(points().astype(float) + 1e300),
    "1e12 rows announced": npy_header(
        "{'descr': '<f4', 'fortran_order': False, 'shape': (1000000000000, 3), }      \n"
    ),
    "-1 rows announced": npy_header(
        "{'descr': '<f4', 'fortran_order': False, 'shape': (-1, 3), }                   \n"
    ),
    "a header that is code": npy_header(
        "__import__('os').system('ls')                                               \n"
    ),
    "a header nested deep": npy_header("(" * 9000 + ")" * 9000 + "\n"),
    "a type of fields": npy_header(
        "{'descr': [('a', '<f4')], 'fortran_order': False, 'shape': (3, 3), }            \n"
    ),
    "a type of pickles": npy_header(
        "{'descr': '|O', 'fortran_order': False, 'shape': (3, 3), }                      \n"
    ),
    "dates": npy(np.zeros((5, 3), "datetime64[s]")),
}
PCDS = {
    "1e18 points": _pcd(WIDTH="1000000000000000000", POINTS="1000000000000000000"),
    "-5 points": _pcd(WIDTH="-5"),
    "a count of 1e9": _pcd(COUNT="1000000000 1 1"),
    "a count of 0": _pcd(COUNT="0 1 1"),
    "a count of -1": _pcd(COUNT="-1 1 1"),
    "a size of 3": _pcd(SIZE="3 4 4"),
    "no size": _pcd(SIZE=""),
    "no x": _pcd(FIELDS="a y z"),
    "compressed": _pcd(DATA="binary_compressed"),
    "a view point of NaN": _pcd(VIEWPOINT="nan 0 0 1 0 0 0"),
    "a view point of text": _pcd(VIEWPOINT="a b c 1 0 0 0"),
    "a height of 10^400": _pcd(HEIGHT="9" * 400),
    "ASCII that is binary": _pcd(DATA="ascii"),
    "no points": _pcd(WIDTH="0", POINTS="0"),
}
HALF_FLOATS = npy_header("{'descr': '<f2', 'fortran_order': False, 'shape': (316666600, 3), }" + " " * 47 + "\n")[:128]
HANDMADE = [
    *(views_case(name, *values) for name, values in CAMERAS.items()),
    *(views_case(f"an image {name}", _camera(), "refused", depth=data) for name, data in IMAGES.items()),
    *(views_case(f"a mask {name}", _camera(), "either", mask=data) for name, data in IMAGES.items()),
    *(cloud_case("npy", name, data, "refused") for name, data in NPY.items()),
    *(cloud_case("pcd", name, data, "refused") for name, data in PCDS.items()),
    *(
        cloud_case(kind, "a hole of 1.9 GB", Hole(1_900_000_000, cloud(kind)[:300]), "refused")
        for kind in ("npy", "pcd", "ply")
    ),
    cloud_case("npy", "a hole of 1.9 GB that is announced", Hole(1_900_000_128, HALF_FLOATS), "refused"),
    views_case("a hole of 90 MB", Hole(90_000_000, b"[")),
    cloud_case("pcd", "valid", cloud("pcd"), "accepted"),
    *(cloud_case(kind, "a pipe", Pipe(), "refused") for kind in ("npy", "pcd", "ply")),
    *(cloud_case(kind, "empty", b"", "refused") for kind in ("npy", "pcd", "ply")),
    cloud_case("ply", "1e12 points announced", cloud("ply").replace(b"%d" % SIDE**2, b"1000000000000"), "refused"),
]
DRAWS: dict[str, Draw] = {"depth": _views, **{f"cloud {kind}": _cloud(kind) for kind in ("npy", "pcd", "ply")}}
