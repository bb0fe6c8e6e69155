"""Files of strangers are refused: in one line, soon, and without much memory."""

import json
import struct
import subprocess
import sys
import zipfile
import zlib
from functools import cache, partial

import bounded_program
import hostile_files as hostile
import lz4.frame
import numpy as np
import pytest
import yaml
from small_camera import CAMERA

from coded_aperture_ros.likelihood.bank import LearnConfig, learn_bank, save_bank
from coded_aperture_ros.optics import Mask, render_psf_stack

LARGEST_GROWTH_BYTES = 500 * 2**20
LONGEST_S = 5.0
VIEW = "CREATE VIEW messages AS " + hostile.COUNTING
BIG_ZIP = partial(hostile.npz, schema=hostile.array("coded-aperture filter bank"))
TREE = "CREATE VIRTUAL TABLE messages USING rtree(id, topic_id, timestamp)"
FORMATS = [each.format("") for each in hostile.TABLES]
TRIGGER = (
    "CREATE TRIGGER bomb AFTER INSERT ON topics BEGIN INSERT INTO topics SELECT * FROM topics; END"
)
COMPUTED = (
    "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, "
    "data BLOB AS (zeroblob(900000000)))"
)
ROWS = "INSERT INTO messages(topic_id, timestamp) VALUES (1, 1), (1, 2), (1, 3)"
MANY_TOPICS = (
    "INSERT INTO topics WITH RECURSIVE n(i) AS (SELECT 2 UNION ALL SELECT i + 1 FROM n "
    "WHERE i < 200000) SELECT i, '/a_topic_with_a_name_' || i, 'std_msgs/msg/String', 'cdr', '' "
    "FROM n"
)
PIXELS = bytes(64 * 2**20)


def single(size):
    """Message in no chunk that declares a size."""
    return struct.pack("<BQ", 5, size)


CASES = {
    # Pictures: their size is judged before their pixels.
    "wide.png": lambda: hostile.png(65535, 65535),
    "true.png": lambda: hostile.png(60000, 30000, PIXELS, 16, 2),
    "negative.png": lambda: hostile.png(2**31 - 1, 2**31 - 1),
    "text.png": lambda: hostile.png(8, 8, before=b"\xff\xff\xff\xf0zTXt" + bytes(100)),
    "wide.jpg": lambda: hostile.jpeg(65535, 65535),
    "progressive.jpg": lambda: hostile.jpeg(65535, 65535, 0xC2),
    "scans.jpg": lambda: hostile.jpeg(8000, 8000, 0xC2, 30_000),
    "wide.tif": lambda: hostile.tiff(hostile.tiff_picture(200_000, 200_000), bytes(4)),
    "tiles.tif": lambda: hostile.tiff(
        hostile.tiff_picture(64, 64, t322=2**20, t323=2**20, t324=8, t325=4), bytes(4)
    ),
    "deflate.tif": lambda: hostile.tiff(
        hostile.tiff_picture(64, 64, t259=8, t279=len(_deflated())), _deflated()
    ),
    "circle.tif": lambda: hostile.tiff(hostile.tiff_picture(8, 8, t254=1), bytes(64), 8),
    "wide.ppm": lambda: b"P6 100000 100000 255\n" + bytes(100),
    "digits.pgm": lambda: b"P5 " + b"9" * 100_000 + b" 4 255\n" + bytes(100),
    "words.pgm": lambda: b"P2 20000 20000 255\n" + b"1 " * 10_000_000,
    "wide.pam": lambda: b"P7\nWIDTH 99999\nHEIGHT 99999\nDEPTH 4\nMAXVAL 255\nENDHDR\n",
    "wide.bmp": lambda: b"BM" + bytes(12) + b"\x28\0\0\0" + b"\0\0\1\0" * 2 + bytes(40),
    "wide.webp": lambda: b"RIFF\0\0\0\0WEBPVP8X" + bytes(4) + b"\xff" * 14 + bytes(40),
    "wide.hdr": lambda: b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 100000 +X 100000\n" + bytes(99),
    "wide.npy": lambda: hostile.npy((10**6, 10**6)),
    "objects.npy": lambda: hostile.npy((2,), "|O", b"cos\nsystem\n(S'true'\ntR."),
    "nested.npy": lambda: hostile.npy((1,), "(1000000000,)<f8", bytes(8)),
    # Archives.
    "zeros.npz": lambda: BIG_ZIP(a=hostile.npy((2**29,), "|u1", bytes(2**29))),
    "declared.npz": lambda: BIG_ZIP(a=hostile.npy((2**40,))),
    "negative.npz": lambda: BIG_ZIP(a=hostile.npy((-1, 2**62))),
    "overflow.npz": lambda: BIG_ZIP(a=hostile.npy((2**62, 2**62, 0, 3))),
    "objects.npz": lambda: BIG_ZIP(a=hostile.npy((2,), "|O", b"cos\nsystem\n(S'true'\ntR.")),
    "lzma.npz": lambda: BIG_ZIP(zipfile.ZIP_LZMA, a=hostile.array(np.zeros(10))),
    "members.npz": lambda: BIG_ZIP(**{f"a{number}": b"" for number in range(60_000)}),
    "brackets.npz": lambda: BIG_ZIP(a=hostile.npy("(" * 9000)),
    "packed.npz": lambda: BIG_ZIP(a=BIG_ZIP(a=hostile.npy((2**28,), "|u1", bytes(2**28)))),
    # YAML.
    "aliases.yaml": lambda: _aliases(),
    "brackets.yaml": lambda: b"[" * 100_000,
    "long.yaml": lambda: b"a: " + b"9" * 900_000,
    "large.yaml": lambda: b"a: 1\n" * 10**6,
    # MCAP.
    "chunk.mcap": lambda: hostile.mcap(hostile.chunk(hostile.zeros(2**30), 2**30)),
    "unsaid.mcap": lambda: hostile.mcap(hostile.chunk(hostile.zeros(2**30), 2**20)),
    "lz4.mcap": lambda: hostile.mcap(hostile.chunk(hostile.zeros(2**29, lz4.frame), 2**40, "lz4")),
    "length.mcap": lambda: hostile.mcap(hostile.chunk(b"x", 2**63, "", 2**63)),
    "many.mcap": lambda: hostile.mcap(*[hostile.chunk(hostile.zeros(2**27), 2**27)] * 100),
    "single.mcap": lambda: hostile.mcap(single(2**62)),
    "gaps.mcap": lambda: hostile.mcap((b"\x05" + bytes(7) + b"\xff" * 20) * 30_000),
    # Bags that are compressed as a whole.
    "zeros.mcap.zstd": lambda: hostile.zeros(2**33),
    "zeros.db3.zstd": lambda: hostile.zeros(2**33),
    # SQLite.
    "view.db3": [FORMATS[0], FORMATS[2], f"{VIEW} SELECT i AS id, 1 AS topic_id, i AS timestamp, "
                 "zeroblob(100000) AS data FROM n"],
    "topics.db3": [FORMATS[1], f"CREATE VIEW topics AS {hostile.COUNTING} SELECT i AS id, "
                   "'/t' || i AS name, 'x' AS type, 'cdr' AS serialization_format FROM n"],
    "definitions.db3": [*FORMATS, f"CREATE VIEW message_definitions AS {hostile.COUNTING} SELECT i "
                        "AS topic_type, zeroblob(1000000) AS encoded_message_definition FROM n"],
    "virtual.db3": [FORMATS[0], FORMATS[2], TREE],
    "computed.db3": [FORMATS[0], FORMATS[2], COMPUTED, ROWS],
    "trigger.db3": [*FORMATS, TRIGGER],
    "topics_200000.db3": [*FORMATS[:2], MANY_TOPICS],
    "circle.db3": hostile.circle,
    # No files.
    "device.png": "/dev/zero",
    "device.npz": "/dev/zero",
    "device.yaml": "/dev/zero",
    "device.npy": "/dev/zero",
}  # fmt: skip


@cache
def _deflated():
    return zlib.compress(bytes(2**29), 9)


def _aliases():
    lines = [b"a0: &a0 [x]"]
    for number in range(1, 30):
        before = b", ".join([b"*a%d" % (number - 1)] * 9)
        lines.append(b"a%d: &a%d [%s]" % (number, number, before))
    return b"\n".join(lines)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("hostile")
    (folder / "camera.yaml").write_text(yaml.safe_dump(CAMERA))
    stack = render_psf_stack(Mask.named("levin"), [3.0, 5.0, 7.0])
    save_bank(learn_bank(stack, LearnConfig(window_px=16)), folder / "bank.npz")
    return folder


def command(path, folder):
    """Words of a program that reads a file of this kind."""
    bank = str(folder / "bank.npz")
    camera = str(folder / "camera.yaml")
    out = str(folder / "out")
    name = str(path)
    if path.suffix == ".npz":
        return "depth", "--bank", name, "a.png", "-o", f"{out}.npy"
    if path.suffix == ".yaml":
        return "learn", "--camera", name, "--depth-range", "1", "2", "-o", f"{out}.npz"
    if path.suffix in (".mcap", ".db3", ".zstd"):
        return "bag", name, "--bank", bank, "--camera", camera, "-o", f"{out}_bag"
    return "depth", "--bank", bank, "--as-levels", name, "-o", f"{out}.npy"


@pytest.fixture(scope="module")
def results(folder):
    """What became of each file."""
    lines = []
    for name, content in CASES.items():
        path = folder / name
        if isinstance(content, str):
            path.symlink_to(content)
        elif isinstance(content, list):
            hostile.sqlite(path, *content)
        elif content is hostile.circle:
            content(path)
        else:
            path.write_bytes(content())
        lines.append(json.dumps(command(path, folder)))
    done = subprocess.run(
        [sys.executable, bounded_program.__file__, "3"],
        input="\n".join(lines),
        text=True,
        capture_output=True,
        timeout=600,
        cwd=folder,
    )
    assert done.returncode == 0, done.stderr
    return dict(zip(CASES, map(json.loads, done.stdout.splitlines()), strict=True))


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", CASES)
def test_hostile_file_is_refused_in_a_line(results, name, folder):
    result = results[name]
    *hints, line = result["errors"].splitlines() or [""]
    assert result["status"] == 1, result["errors"][-2000:]
    assert line.startswith("coded_aperture: error: ")
    assert f"/{name}" in line
    assert len(line) < 1000
    assert all(hint.startswith("coded_aperture: ") for hint in hints), result["errors"][-2000:]
    assert result["seconds"] < LONGEST_S
    assert result["growth"] < LARGEST_GROWTH_BYTES
    assert not list(folder.glob("out*"))
    assert not list(folder.glob(".*"))
