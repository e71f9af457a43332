# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""sqlite3 bags of somebody else: the file counts, and what would never end is refused."""
import os
import resource
import shutil
import sqlite3
import subprocess
import sys

from bags.compression import unpack_message
from bags.decode import typestore
from bags.errors import BagError
from bags.export import export_video
from bags.mcap_records import MAX_CHUNK
from bags.qos_text import offered_qos
from bags.reader import BagReader
from bags.verify import verify_bag
from msgs_bridge.yaml_text import dump_yaml
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
import yaml
import zstandard

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


def assert_refused(bag, commands, told):
    """See that a changed database is refused, by its folder and by itself."""
    folder, file = bag
    changed(file, *commands)
    for path in (folder, file):
        with pytest.raises(BagError, match=told):
            BagReader(path)


def with_metadata(folder, change):
    path = folder / 'metadata.yaml'
    content = yaml.safe_load(path.read_text())
    body = content['rosbag2_bagfile_information']
    change(body, body['topics_with_message_count'][0]['topic_metadata'])
    path.write_text(dump_yaml(content))


@pytest.mark.parametrize(('change', 'told'), [
    (lambda body, topic: topic.update(offered_qos_profiles=[offered_qos()]), []),
    (lambda body, topic: topic.update(type_description_hash='RIHS01_' + 64 * '7'), []),
    (lambda body, topic: body['starting_time'].update(nanoseconds_since_epoch=8), []),
    (lambda body, topic: body.update(message_count=999),
     ['metadata.yaml says 999 messages, the files hold 5']),
    (lambda body, topic: topic.update(type=5),
     ['metadata.yaml says /reward is 5, the files say std_msgs/msg/Float32']),
    (lambda body, topic: topic.update(name='/other'),
     ['metadata.yaml says there is /other, there is not',
      'metadata.yaml does not name the topic /reward']),
])
def test_the_file_counts_and_not_its_metadata(bag, change, told):
    folder, file = bag
    changed(file, *(f'INSERT INTO messages(topic_id, timestamp, data) SELECT 1, {time}, data '
                    'FROM messages WHERE id = 1' for time in (7, 6, 9, 9)))
    with_metadata(folder, lambda body, topic: (
        body.update(message_count=5), body['topics_with_message_count'][0].update(
            message_count=5)))
    with_metadata(folder, change)
    with BagReader(folder) as reader:
        assert (reader.start_time, reader.end_time, reader.message_count) == (5, 9, 5)
        assert [one.log_time for one in reader.messages(start=reader.start_time)] == [
            5, 6, 7, 9, 9]
        assert [one.log_time for one in reader.messages(start=6, stop=9)] == [6, 7]
        assert reader.topics['/reward'].message_count == 5
        assert verify_bag(reader).problems == told


def test_the_files_of_a_bag_are_read_by_their_times(bag):
    folder, file = bag
    second = folder / 'bag_1.db3'
    shutil.copy(file, second)
    changed(file, 'UPDATE messages SET timestamp = 50')
    with_metadata(folder, lambda body, topic: body.update(
        relative_file_paths=['bag.db3', 'bag_1.db3'], message_count=2, files=[]))
    with BagReader(folder) as reader:
        assert [one.log_time for one in reader.messages()] == [5, 50]
        assert (reader.start_time, reader.end_time, reader.message_count) == (5, 50, 2)
        assert reader.problems == []
    changed(second, "UPDATE topics SET type = 'std_msgs/msg/Int32'")
    with pytest.raises(BagError, match='is of type std_msgs/msg/Int32 and of type'):
        BagReader(folder)


def test_a_bag_of_more_files_than_may_be_open_is_read(bag):
    folder, file = bag
    names = [f'bag_{number}.db3' for number in range(30)]
    for name in names:
        shutil.copy(file, folder / name)
    with_metadata(folder, lambda body, topic: (
        body.update(relative_file_paths=names, message_count=30, files=[]),
        body['topics_with_message_count'][0].update(message_count=30)))
    limit, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    # the lowest number that is free
    with open(os.devnull) as free:
        resource.setrlimit(resource.RLIMIT_NOFILE, (free.fileno() + 10, most))
    try:
        with BagReader(folder) as reader:
            assert len(list(reader.messages())) == reader.message_count == 30
            assert verify_bag(reader).good
            messages = reader.messages()
            next(messages)
            shutil.copy(file, folder / 'other')
            (folder / 'other').replace(folder / names[-1])
            with pytest.raises(BagError, match=f'{names[-1]} was replaced meanwhile'):
                list(messages)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (limit, most))


@pytest.mark.parametrize(('commands', 'told'), [
    (("UPDATE messages SET data = 'hello'",), 'data are no bytes'),
    (('UPDATE messages SET data = 1000000',), 'data are no bytes'),
    (("UPDATE messages SET timestamp = 'abc'",), 'no whole number from 0'),
    (('UPDATE messages SET timestamp = -3',), 'no whole number from 0'),
    (('UPDATE messages SET topic_id = 7',), 'messages of topic 7, which it never names'),
    (("UPDATE topics SET type = x'80'",), 'is no text'),
    (('CREATE TABLE t AS SELECT * FROM topics', 'DROP TABLE topics',
      'ALTER TABLE t RENAME TO topics', 'UPDATE topics SET type = NULL'), 'is no text'),
    (("UPDATE topics SET offered_qos_profiles = '{'",), 'is not valid YAML'),
    (('DROP TABLE topics',), 'no such column|no such table'),
])
def test_a_database_that_holds_something_else_is_refused(bag, commands, told):
    assert_refused(bag, commands, told)


def test_databases_of_older_versions_lack_columns(bag):
    folder, file = bag
    changed(file, 'ALTER TABLE topics DROP COLUMN type_description_hash',
            'ALTER TABLE topics DROP COLUMN offered_qos_profiles', 'DROP TABLE schema')
    with BagReader(file) as reader:
        assert [one.log_time for one in reader.messages()] == [5]
        assert reader.topics['/reward'].qos == []


def packed(folder, file, data):
    base = sqlite3.connect(file)
    base.execute('UPDATE messages SET data = ?', (data,))
    base.commit()
    base.close()
    with_metadata(folder, lambda body, topic: body.update(
        compression_mode='message', compression_format='zstd'))


def test_messages_that_are_packed_by_themselves_are_unpacked_within_bounds(bag):
    folder, file = bag
    packed(folder, file, zstandard.compress(b'what was sent'))
    with BagReader(folder) as reader:
        assert [one.data for one in reader.messages()] == [b'what was sent']
    packed(folder, file, zstandard.compress(bytes(MAX_CHUNK + 1)))
    with BagReader(folder) as reader, pytest.raises(BagError, match='bag.db3.* unpacks to 268435'):
        list(reader.messages())
    for data in (b'', b'no frame', zstandard.compress(bytes(1000))[:-3],
                 zstandard.ZstdCompressor(write_content_size=False).compress(bytes(1000))):
        with pytest.raises(BagError):
            unpack_message(data)
    with_metadata(folder, lambda body, topic: body.update(compression_format='lz4'))
    with pytest.raises(BagError, match='is compressed message by message'):
        BagReader(folder)


def test_a_check_reads_every_message_of_a_database(bag):
    folder, file = bag
    with BagReader(folder) as reader:
        found = verify_bag(reader)
    assert found.good
    assert found.notes[0].startswith('sqlite3 keeps no CRCs')
    packed(folder, file, zstandard.compress(bytes(1000))[:-3])
    with BagReader(folder) as reader:
        problems = verify_bag(reader).problems
    assert len(problems) == 1 and 'message of 5 ns: ' in problems[0], problems


def test_a_check_finds_what_is_wrong_with_the_structure_of_a_database(bag):
    folder, file = bag
    changed(file, *(f'INSERT INTO messages(topic_id, timestamp, data) SELECT 1, {time}, data '
                    'FROM messages WHERE id = 1' for time in range(10, 500)))
    with_metadata(folder, lambda body, topic: body.update(message_count=491))
    data = file.read_bytes()
    # an entry of the index of times, beside that of the message itself
    place = data.rindex((499).to_bytes(2, 'big'))
    file.write_bytes(data[:place] + (498).to_bytes(2, 'big') + data[place + 2:])
    with BagReader(folder) as reader:
        assert any('bag.db3: ' in problem for problem in verify_bag(reader).problems)


WRITE_AND_DIE = """import os, sqlite3, sys
base = sqlite3.connect(sys.argv[1])
base.execute('PRAGMA journal_mode = ' + sys.argv[2])
base.execute('PRAGMA cache_size = 1')
for number in range(100):
    base.execute('INSERT INTO messages(topic_id, timestamp, data) VALUES (1, ?, ?)',
                 (number, bytes(5000)))
    if sys.argv[2] == 'WAL':
        base.commit()
os._exit(0)
"""


@pytest.mark.parametrize(('mode', 'there'), [('WAL', 101), ('DELETE', 1)])
def test_a_database_that_was_not_completed_is_refused_with_the_way_out(bag, mode, there):
    folder, file = bag
    subprocess.run([sys.executable, '-c', WRITE_AND_DIE, str(file), mode], check=True)
    for path in (folder, file):
        with pytest.raises(BagError, match=r"count\(\*\) FROM messages'` takes it in"):
            BagReader(path)
    base = sqlite3.connect(file)
    assert base.execute('SELECT count(*) FROM messages').fetchone() == (there,)
    base.close()
    with BagReader(file) as reader:
        assert reader.message_count == there


@pytest.mark.parametrize('name', ['p%61', 'a#b', 'a?mode=rw', 'with space'])
def test_a_folder_may_have_any_name(bag, name):
    folder, file = bag
    moved = folder.with_name(name)
    # where the name would lead if it were an address
    shutil.copytree(folder, folder.with_name('pa'))
    changed(folder.with_name('pa') / 'bag.db3', 'DELETE FROM messages')
    folder.rename(moved)
    with BagReader(moved) as reader:
        assert [one.log_time for one in reader.messages()] == [5]


@pytest.mark.parametrize(('commands', 'told'), [
    (('ALTER TABLE messages RENAME TO m', f'CREATE VIEW messages AS {ENDLESS}'),
     'has the view messages'),
    (('ALTER TABLE topics ADD big AS (zeroblob(1000000000))',), 'topics has computed columns'),
    ((f'CREATE TRIGGER t AFTER INSERT ON topics BEGIN {ENDLESS.replace("x data", "1")}; END',),
     'has the trigger t'),
])
def test_a_database_that_computes_when_it_is_read_is_refused(bag, commands, told):
    assert_refused(bag, commands, told)


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
