"""SQLite files of bags: what a recorder leaves that died, and damage in the middle."""

import shutil
import sqlite3
import tempfile

import numpy as np
import pytest
from bag_scene import IMAGE, START_NS, STRING, image, storage_file, text, write_bag

from coded_aperture_ros.bags import Bag

COMMITTED, ALL = 4, 12
INSERT = "INSERT INTO messages VALUES (?, ?, ?, ?)"


def wide_image(index):
    pixels = np.random.default_rng(index).integers(0, 255, (40, 500), np.uint8)
    return image(pixels, "mono8", index)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """File of a bag of images and its rows."""
    messages = [("/image", IMAGE, START_NS + i, wide_image(i)) for i in range(ALL)]
    file = storage_file(write_bag(tmp_path_factory.mktemp("whole") / "bag", messages, "sqlite3"))
    with sqlite3.connect(file) as database:
        return file, database.execute("SELECT * FROM messages ORDER BY id").fetchall()


def died(whole, folder, mode, *settings, name="bag_0.db3", commits=False):
    """Folder that a recorder leaves that dies while it writes, with a journal of a mode."""
    file, rows = whole
    folder.mkdir(exist_ok=True)
    live = folder.parent / f"live_{mode}_{name}"
    shutil.copy(file, live)
    database = sqlite3.connect(live, isolation_level=None)
    database.execute(f"DELETE FROM messages WHERE id > {COMMITTED}")
    database.execute("VACUUM")
    for setting in (*settings, f"journal_mode = {mode}", "cache_size = 1", "cache_spill = 1"):
        database.execute(f"PRAGMA {setting}").fetchall()
    database.execute("BEGIN")
    database.executemany(INSERT, rows[COMMITTED:])
    if commits:
        database.execute("COMMIT")
    # Now the power fails.
    for left in live.parent.glob(f"{live.name}*"):
        shutil.copy(left, folder / left.name.replace(live.name, name))
    if not commits:
        database.execute("ROLLBACK")
    database.close()
    return folder


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def images(path):
    with Bag(path) as bag:
        return [message.data for message in bag.messages("/image")], bag.damage


@pytest.mark.parametrize(
    ("mode", "settings", "commits", "expected", "leaves"),
    [
        ("DELETE", (), False, COMMITTED, "-journal"),
        ("PERSIST", (), False, COMMITTED, "-journal"),
        ("TRUNCATE", (), False, COMMITTED, "-journal"),
        ("WAL", ("wal_autocheckpoint = 0",), True, ALL, "-wal"),
        ("WAL", ("wal_autocheckpoint = 0",), False, COMMITTED, "-wal"),
        ("WAL", ("locking_mode = EXCLUSIVE", "wal_autocheckpoint = 0"), True, ALL, "-wal"),
    ],
)
def test_what_sqlite_recovers_is_read(whole, tmp_path, mode, settings, commits, expected, leaves):
    folder = died(whole, tmp_path / "bag", mode, *settings, commits=commits)
    assert (folder / f"bag_0.db3{leaves}").stat().st_size > 0
    before = contents(folder)
    shutil.copytree(folder, tmp_path / "copy")
    with sqlite3.connect(tmp_path / "copy" / "bag_0.db3") as database:
        assert database.execute("SELECT count(*) FROM messages").fetchone() == (expected,)
    for path in (folder, folder / "bag_0.db3"):
        found, damage = images(path)
        assert found == [row[3] for row in whole[1][:expected]]
        assert f"recovered by means of bag_0.db3{leaves}" in damage
    assert contents(folder) == before
    assert not list(folder.parent.glob("coded_aperture_*"))


def test_a_log_without_its_index_file_is_recovered(whole, tmp_path):
    folder = died(whole, tmp_path / "bag", "WAL", "wal_autocheckpoint = 0", commits=True)
    (folder / "bag_0.db3-shm").unlink()
    assert len(images(folder)[0]) == ALL


@pytest.mark.parametrize("mode", ["PERSIST", "TRUNCATE"])
def test_a_journal_that_is_done_is_no_damage(whole, tmp_path, mode):
    folder = died(whole, tmp_path / "bag", mode, commits=True)
    assert (folder / "bag_0.db3-journal").exists()
    found, damage = images(folder / "bag_0.db3")
    assert (len(found), damage) == (ALL, "")


def test_of_several_files_the_last_one_is_recovered(whole, tmp_path):
    folder = died(whole, tmp_path / "bag", "WAL", "wal_autocheckpoint = 0", commits=True)
    died(whole, folder, "DELETE", name="bag_1.db3")
    shutil.copy(whole[0], folder / "bag_2.db3")
    found, damage = images(folder)
    rows = [row[3] for row in whole[1]]
    assert found == [*rows, *rows[:COMMITTED], *rows]
    assert "bag_0.db3-wal" in damage
    assert "bag_1.db3-journal" in damage
    assert "bag_2.db3" not in damage


def test_what_cannot_be_recovered_is_named(whole, tmp_path, monkeypatch):
    """There is no room for a copy."""
    folder = died(whole, tmp_path / "bag", "WAL", "wal_autocheckpoint = 0", commits=True)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "missing"))
    found, damage = images(folder)
    assert found == [row[3] for row in whole[1][:COMMITTED]]
    assert "bag_0.db3-wal left out" in damage
    assert "No such file" in damage


def test_messages_on_both_sides_of_damage_are_read(whole, tmp_path):
    """Pages of one message in the middle are lost."""
    damaged = tmp_path / "bag_0.db3"
    data = bytearray(whole[0].read_bytes())
    place = data.index(whole[1][ALL // 2][3][8000:8100])
    page = place // 4096 * 4096
    data[page : page + 4] = b"\xff" * 4
    damaged.write_bytes(data)
    found, damage = images(damaged)
    rows = [row[3] for row in whole[1]]
    assert found == [*rows[: ALL // 2], *rows[ALL // 2 + 1 :]]
    assert "bag_0.db3 is damaged, 1 messages cannot be read" in damage


def test_definitions_and_encodings_that_nobody_knows_are_no_damage(tmp_path):
    """As rosbag2 writes them for types that it has no definition of, and for other middleware."""
    messages = [("/a", STRING, 1, text("a")), ("/b", STRING, 2, text("b"))]
    file = storage_file(write_bag(tmp_path / "bag", messages, "sqlite3"))
    with sqlite3.connect(file) as database:
        database.execute("UPDATE message_definitions SET encoding = 'unknown'")
        database.execute("UPDATE topics SET serialization_format = 'json' WHERE name = '/b'")
    with Bag(tmp_path / "bag") as bag:
        assert [message.topic for message in bag.messages()] == ["/a", "/b"]
        assert bag.topics["/a"].foreign is None
        assert str(bag.topics["/b"]) == "/b of std_msgs/msg/String (json)"
        assert bag.damage == ""


VALUES = [None, "a", 1.5, 1e300, b"x", ""]


def changed(whole, folder, table, column, value, where="1"):
    """Return a file with another value in a table, which has no constraints."""
    file = shutil.copy(whole[0], folder / "bag.db3")
    with sqlite3.connect(file) as database:
        database.execute(f"CREATE TABLE free AS SELECT * FROM {table}")
        database.execute(f"DROP TABLE {table}")
        database.execute(f"ALTER TABLE free RENAME TO {table}")
        database.execute(f"UPDATE {table} SET {column} = ? WHERE {where}", (value,))
    return file


@pytest.mark.parametrize("value", VALUES, ids=str)
@pytest.mark.parametrize("column", ["id", "topic_id", "timestamp", "data"])
def test_values_of_another_type_are_left_out(whole, tmp_path, column, value):
    """SQLite puts any value into any column."""
    found, _ = images(changed(whole, tmp_path, "messages", column, value, "id = 2"))
    is_sound = column == "data" and isinstance(value, bytes)
    # 1.5 is cast to the number of the topic.
    assert len(found) == ALL - 1 + (is_sound or (column, value) == ("topic_id", 1.5))


@pytest.mark.parametrize("value", VALUES, ids=str)
@pytest.mark.parametrize("column", ["type", "serialization_format", "offered_qos_profiles"])
def test_texts_of_a_topic_may_be_of_any_type(whole, tmp_path, column, value):
    with Bag(changed(whole, tmp_path, "topics", column, value)) as bag:
        topic = bag.topics["/image"]
        assert len(list(bag.messages())) in (0, ALL)
    assert isinstance(topic.type_name, str)
    assert isinstance(topic.qos, tuple)
    assert str(topic)


@pytest.mark.parametrize("value", VALUES, ids=str)
@pytest.mark.parametrize("column", ["topic_type", "encoded_message_definition"])
def test_definitions_of_another_type_are_none(whole, tmp_path, column, value):
    with Bag(changed(whole, tmp_path, "message_definitions", column, value)) as bag:
        (topic,) = bag.topics.values()
    # Columns of text turn numbers into it.
    is_text = column != "topic_type" and isinstance(value, str | float)
    assert bool(topic.definition) == (is_text and value != "")
    assert isinstance(topic.definition, str)
