# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""sqlite3 bags of somebody else: what would never end is refused before it is read."""
import os
import sqlite3

from bags.decode import typestore
from bags.errors import BagError
from bags.export import export_video
from bags.reader import BagReader
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

ENDLESS = """WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c)
    SELECT x id, 1 topic_id, x timestamp, x data FROM c"""


@pytest.fixture
def bag(tmp_path):
    """Return a sqlite3 bag of one message and its file."""
    folder = tmp_path / 'bag'
    with Writer(folder, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection(
            '/reward', 'std_msgs/msg/Float32', typestore=typestore())
        writer.write(connection, 5, b'\0\1\0\0' + bytes(4))
    with BagReader(folder) as reader:
        assert [one.log_time for one in reader.messages()] == [5]
    return folder, folder / 'bag.db3'


def changed(file, *commands):
    base = sqlite3.connect(file)
    for command in commands:
        base.execute(command)
    base.commit()
    base.close()


@pytest.mark.parametrize(('commands', 'told'), [
    (('ALTER TABLE messages RENAME TO m', f'CREATE VIEW messages AS {ENDLESS}'),
     'has the view messages'),
    (('ALTER TABLE topics ADD big AS (zeroblob(1000000000))',), 'topics has computed columns'),
    ((f'CREATE TRIGGER t AFTER INSERT ON topics BEGIN {ENDLESS.replace("x data", "1")}; END',),
     'has the trigger t'),
])
def test_a_database_that_computes_when_it_is_read_is_refused(bag, commands, told):
    folder, file = bag
    changed(file, *commands)
    for path in (folder, file):
        with pytest.raises(BagError, match=told):
            BagReader(path)


def test_a_fifo_is_no_database(bag):
    folder, file = bag
    file.unlink()
    os.mkfifo(file)
    for path in (folder, file):
        with pytest.raises(BagError, match='regular file'):
            BagReader(path)


def test_a_file_that_is_packed_as_a_whole_is_named_so(bag):
    _, file = bag
    packed = file.with_name('bag.db3.zstd')
    file.rename(packed)
    with pytest.raises(BagError, match='compressed as a whole; unpack it'):
        BagReader(packed)


def test_a_video_has_one_kind_of_name(bag, tmp_path):
    with BagReader(bag[0]) as reader, pytest.raises(BagError, match='is written as .mp4 or .webp'):
        export_video(reader, tmp_path / 'lap.xyz')
