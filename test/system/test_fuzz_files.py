"""Bombs of every kind of file under a memory limit of 2 GiB, and sound files with absurd sizes.

A few cases; with FUZZ_TIMES=1, as `make fuzz` sets it, some hundreds of others each time.
"""

import json
import struct
import subprocess
import sys
from functools import cache

import bounded_program
import hostile_files as hostile
import lz4.frame
import numpy as np
import pytest
from bag_scene import IMAGE, SUFFIXES, image, write_bag
from fuzzing import TIMES, cases
from hypothesis import given
from hypothesis import strategies as st
from small_camera import coded_wall, write_model
from waiting import scaled

from coded_aperture_ros.io import write_depth, write_image
from coded_aperture_ros.optics import load_camera

ADDRESS_SPACE_GIB = "2"
LARGEST_GROWTH_BYTES = 500 * 2**20
LONGEST_S = 5.0
# Each takes a tenth of a second, of sound files two: the fast suite has a few.
BOMBS, DAMAGED = (400, 80) if TIMES >= 1 else (100, 30)


class Bounded:
    """Programs that read one file each, with little memory."""

    def __init__(self, folder):
        self.folder = folder
        self._model = write_model(folder)
        command = [sys.executable, bounded_program.__file__, ADDRESS_SPACE_GIB]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
        self._program = subprocess.Popen(command, cwd=folder, **pipes)

    def run(self, name, write):
        """Let the program that reads such a file read it; check what it says and leaves."""
        path = self.folder / name
        write(path)
        print(json.dumps(self._words(path)), file=self._program.stdin, flush=True)
        result = json.loads(self._program.stdout.readline())
        path.unlink()
        errors = result["errors"]
        assert result["status"] in (0, 1), errors
        assert "Traceback" not in errors
        lines = errors.splitlines()
        # What libpng itself prints about chunks cannot be kept from it.
        assert all(line.startswith(("coded_aperture: ", "libpng ")) for line in lines), errors
        assert all(len(line) < 2100 for line in lines)
        assert result["status"] == 0 or ": error: " in lines[-1]
        assert result["seconds"] < scaled(LONGEST_S)
        assert result["growth"] < LARGEST_GROWTH_BYTES
        outputs = list(self.folder.glob("out*"))
        assert bool(outputs) == (result["status"] == 0 or (bool(outputs) and "no depth" in errors))
        assert not list(self.folder.glob(".*"))
        for output in outputs:
            subprocess.run(["rm", "-r", output], check=True)

    def _words(self, path):
        bank, camera = self._model["bank"], self._model["camera_file"]
        out, name = f"{self.folder}/out", str(path)
        if path.suffix == ".npz":
            return "depth", "--bank", name, "a.png", "-o", f"{out}.npy"
        if path.suffix == ".yaml":
            few = "--depth-range", "1", "2", "--level-count", "2"
            return "learn", "--camera", name, *few, "-o", f"{out}.npz"
        if path.suffix in (".mcap", ".db3", ".zstd"):
            model = "--bank", bank, "--camera", camera, "--temporal-frames", "2"
            return "bag", name, *model, "-o", out
        return "depth", "--bank", bank, "--as-levels", name, "-o", f"{out}.npy"

    def close(self):
        self._program.communicate()


@pytest.fixture(scope="module")
def bounded(tmp_path_factory):
    bounded = Bounded(tmp_path_factory.mktemp("bounded"))
    yield bounded
    bounded.close()


# Sizes at which counters, products and limits turn.
EDGES = [0, 1, 2, 7, 2**15, 2**16 - 1, 2**16, 2**26, 2**31 - 1, 2**31, 2**32 - 1]
SIZES = st.sampled_from(EDGES)
LONG_SIZES = st.sampled_from([-1, *EDGES, 2**40, 2**62, 2**63 - 1, 2**63, 2**64 - 1])
ZEROS = st.sampled_from([0, 1, 1000, 2**20, 2**24])


@cache
def zeros(size, kind):
    """Compressed zeros."""
    if kind == "lz4":
        return hostile.zeros(size, lz4.frame)
    return hostile.zeros(size) if kind == "zstd" else bytes(min(size, 2**20))


@st.composite
def pictures(draw):
    kind = draw(st.sampled_from(["png", "jpg", "tif", "pnm", "npy"]))
    width, height = draw(SIZES), draw(SIZES)
    if kind == "png":
        depth, colour = draw(st.sampled_from([1, 2, 4, 8, 16, 3, 0])), draw(st.integers(0, 7))
        return ".png", hostile.png(width, height, bytes(draw(ZEROS)), depth, colour)
    if kind == "jpg":
        sides = width % 2**16, height % 2**16
        return ".jpg", hostile.jpeg(*sides, draw(st.integers(0xC0, 0xCF)), draw(st.integers(0, 99)))
    if kind == "tif":
        tags = draw(st.dictionaries(st.integers(254, 340), SIZES, max_size=4))
        tags = {**hostile.tiff_picture(width, height), **tags}
        return ".tif", hostile.tiff(tags, bytes(64), draw(st.sampled_from([0, 8, 72, 2**31])))
    if kind == "pnm":
        words = [draw(st.sampled_from(["P1", "P2", "P4", "P5", "P6", "PF", "Pf", "P7"]))]
        words += [str(draw(LONG_SIZES)) for _ in range(3)]
        return ".pgm", " ".join(words).encode() + b"\n" + bytes(draw(ZEROS) % 2**20)
    return ".npy", draw(arrays())


@st.composite
def arrays(draw):
    shape = tuple(draw(st.lists(LONG_SIZES, max_size=4)))
    dtype = draw(st.sampled_from(["<f4", "|u1", "|O", "<U9", "|V9", "(9,)<f8", "<f2", "<m8[s]"]))
    return hostile.npy(shape, dtype, bytes(draw(ZEROS)))


@st.composite
def archives(draw):
    schema = hostile.array(draw(st.sampled_from(["coded-aperture filter bank", "other"])))
    names = st.sampled_from(["basis", "psfs", "version", "a", "../a", "/a", ""])
    members = draw(st.dictionaries(names, arrays(), max_size=3))
    compression = draw(st.sampled_from([0, 8, 12, 14]))
    content = hostile.npz(compression, **{"schema": schema, **members})
    return ".npz", content[draw(st.integers(0, 40)) :] if draw(st.booleans()) else content


@st.composite
def yamls(draw):
    levels, width = draw(st.integers(0, 40)), draw(st.integers(1, 12))
    lines = ["a0: &a0 [x]"]
    for number in range(1, levels):
        aliases = ", ".join([f"*a{number - 1}"] * width)
        lines.append(f"a{number}: &a{number} [{aliases}]")
    more = [
        "a: &a [*a]", "<<: *a0", "&a a: *a", "? [a, {b: c}]\n: 1", "a: \\0", "--- a\n--- b",
        "!!binary aaaa", "!!set {a, b}", "!!timestamp 9999-99-99", "a: 1:1:1:1:1", "a: .inf",
        "a: 0x" + "f" * 9999, "a: " + "9" * 99_999, "[" * 9999, "{a: " * 999, "- " * 9999,
        "%YAML 9.9", "%TAG ! !" + "a" * 9999, "mask: {name: levin}", "focal_length_px: 400",
        "!!python/object/apply:os.abort []",
    ]  # fmt: skip
    lines += draw(st.lists(st.sampled_from(more), max_size=6))
    return ".yaml", "\n".join(lines).encode()


@st.composite
def mcaps(draw):
    records = []
    for _ in range(draw(st.integers(1, 4))):
        kind = draw(st.sampled_from(["zstd", "lz4", "", "zip"]))
        packed = zeros(draw(ZEROS), kind)
        declared = draw(st.none() | LONG_SIZES.map(lambda size: size % 2**64))
        size = draw(LONG_SIZES) % 2**64
        whole = hostile.chunk(packed, size, kind, declared)
        content = packed[:100] + bytes(draw(st.integers(0, 60)))
        records.append(draw(st.sampled_from([whole, whole, hostile.record(draw(KINDS), content)])))
    return ".mcap", hostile.mcap(*records * draw(st.sampled_from([1, 1, 30])))


KINDS = st.integers(0, 16)
FOREIGN = st.sampled_from(["mcap", "db3"])


@st.composite
def compressed(draw):
    size = draw(st.sampled_from([0, 2**20, 2**26, 2**30]))
    before = draw(st.sampled_from([b"", hostile.MAGIC, b"SQLite format 3\0"]))
    return f".{draw(FOREIGN)}.zstd", before + zeros(size, "zstd")[: draw(LONG_SIZES) or None]


ROWS = [
    "SELECT i AS id, 1 AS topic_id, i AS timestamp, zeroblob({size}) AS data FROM n",
    "SELECT i AS id, '/t' || i AS name, 'sensor_msgs/msg/Image' AS type, 'cdr' AS "
    "serialization_format FROM n",
    "SELECT randomblob({size}) AS id, hex(zeroblob({size})) AS name FROM n",
]
STATEMENTS = [
    "CREATE VIEW {table} AS " + hostile.COUNTING + "{rows}",
    "CREATE TABLE {table}(id INTEGER PRIMARY KEY, topic_id, timestamp, name, data BLOB AS "
    "(zeroblob({size})))",
    "CREATE VIRTUAL TABLE {table} USING fts5(id, topic_id, timestamp, name, type)",
    "INSERT INTO topics SELECT NULL, printf('/%.*c', {size} % 1000000, 'x'), 'a', 'cdr', ''",
    "INSERT INTO messages SELECT NULL, 1, {size}, zeroblob({size} % 1000000)",
    "INSERT INTO messages VALUES (NULL, 'a', 'b', 'c'), (NULL, NULL, 1e300, 1)",
    "CREATE INDEX i ON messages(abs(timestamp))",
    "PRAGMA user_version = {size}",
]


@st.composite
def databases(draw):
    statements = [each.format("") for each in hostile.TABLES if draw(st.integers(0, 3))]
    for each in draw(st.lists(st.sampled_from(STATEMENTS), min_size=1, max_size=3)):
        table = draw(st.sampled_from(["messages", "topics", "schema", "metadata"]))
        rows = draw(st.sampled_from(ROWS))
        size = draw(st.sampled_from([0, 1, 2**20, 2**30 - 1, 2**31 - 1]))
        statements.append(each.format(table=table, rows=rows.format(size=size), size=size))
    return ".db3", statements


def write_database(path, statements):
    """Write what SQLite takes of the statements."""
    database = hostile.sqlite3.connect(path)
    for statement in statements:
        try:
            database.execute(statement)
        except hostile.sqlite3.Error:
            continue
    database.commit()
    database.close()


FILES = st.one_of(pictures(), archives(), yamls(), mcaps(), compressed(), databases())


@given(file=FILES)
@cases(BOMBS)
def test_bombs(bounded, file):
    suffix, content = file

    def write(path):
        if isinstance(content, list):
            write_database(path, content)
        else:
            path.write_bytes(content)

    bounded.run(f"bomb{suffix}", write)


class Sound:
    """Contents of files, which a failure does not print."""

    def __init__(self, contents):
        self.contents = contents


@pytest.fixture(scope="module")
def sound(bounded, tmp_path_factory):
    """Object whose `contents` are those of sound files, by their suffixes."""
    folder = tmp_path_factory.mktemp("sound")
    wall = coded_wall(load_camera(bounded.folder / "camera.yaml"))
    for suffix in (".png", ".jpg", ".tif", ".npy"):
        write = write_depth if suffix == ".npy" else write_image
        write(folder / f"a{suffix}", wall)
    pixels = (wall * 255).astype(np.uint8)
    message = "/image_raw", IMAGE, 0, image(pixels, "mono8", 0)
    contents = [path.read_bytes() for path in sorted(folder.iterdir())]
    names = [path.suffix for path in sorted(folder.iterdir())]
    for storage, suffix in SUFFIXES.items():
        (file,) = write_bag(folder / storage, [message], storage).glob(f"*{suffix}")
        contents.append(file.read_bytes())
        names.append(suffix)
    for name in ("bank.npz", "camera.yaml"):
        contents.append((bounded.folder / name).read_bytes())
        names.append((bounded.folder / name).suffix)
    return Sound(dict(zip(names, contents, strict=True)))


@given(
    suffix=st.sampled_from([".png", ".jpg", ".tif", ".npy", ".mcap", ".db3", ".npz", ".yaml"]),
    places=st.lists(
        st.tuples(st.floats(0, 1), LONG_SIZES, st.sampled_from("bBhHiIqQ"), st.sampled_from("<>")),
        min_size=1,
        max_size=3,
    ),
)
@cases(DAMAGED)
def test_sound_files_with_sizes_at_the_edge(bounded, sound, suffix, places):
    content = bytearray(sound.contents[suffix])
    for share, size, kind, order in places:
        width = struct.calcsize(kind)
        # More often in the first bytes, where headers are.
        at = int(share**3 * (len(content) - width))
        struct.pack_into(order + kind.upper(), content, at, size % 2 ** (8 * width))
    bounded.run(f"damaged{suffix}", lambda path: path.write_bytes(content))
