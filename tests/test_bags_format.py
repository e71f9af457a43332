# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What our bags look like on the disk, and to others who read them."""
from pathlib import Path
import shutil
import subprocess
import sys
import textwrap

from bag_cases import read_all, record_drive, serialized, small_bag
from bags.errors import BagError
from bags.image_arrays import bag_images, load_images
from bags.mcap_file import McapFile
from bags.metadata import BagMetadata, metadata_from_text, metadata_to_text, read_metadata
from bags.qos_text import offered_qos, qos_from_text, qos_to_text
from bags.reader import BagReader
from bags.schemas import schema_of
from bags.writer import BagWriter
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, DataEnd, Footer, Header, MessageIndex, Metadata
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory
import numpy as np
import pytest
from rosbags.rosbag2 import Reader
import yaml

ROOT = Path(__file__).resolve().parents[1]


def read_with_rosbags(folder):
    with Reader(folder) as reader:
        return [(connection.topic, time, bytes(data))
                for connection, time, data in reader.messages()]


def read_with_mcap(folder):
    found = []
    for path in sorted(folder.glob('*.mcap')):
        with path.open('rb') as file:
            reader = make_reader(file, validate_crcs=True)
            found += [(channel.topic, message.log_time, message.publish_time, message.data)
                      for _, channel, message in reader.iter_messages()]
    return found


@pytest.mark.parametrize('compression', ['none', 'lz4', 'zstd'])
def test_mcap_and_rosbags_read_every_byte_of_every_message(tmp_path, compression):
    written = small_bag(tmp_path / 'bag', compression=compression)
    assert read_with_mcap(tmp_path / 'bag') == written
    assert read_with_rosbags(tmp_path / 'bag') == [(one[0], one[1], one[3]) for one in written]
    with BagReader(tmp_path / 'bag') as reader:
        assert read_all(reader) == written
        assert reader.problems == []


def test_records_are_laid_out_as_rosbag2_does(tmp_path):
    small_bag(tmp_path / 'bag', custom_data={'seed': '42'})
    path = tmp_path / 'bag' / 'bag_0.mcap'
    records = list(StreamReader(path.open('rb'), emit_chunks=True, validate_crcs=True).records)
    assert isinstance(records[0], Header)
    assert records[0].profile == 'ros2'
    kinds = [type(record) for record in records]
    assert kinds.count(Chunk) > 3
    for number, kind in enumerate(kinds[:kinds.index(DataEnd)]):
        if kind is Chunk:
            assert kinds[number + 1] is MessageIndex
            assert records[number].uncompressed_crc
    assert records[kinds.index(DataEnd)].data_section_crc
    assert isinstance(records[-1], Footer)
    assert records[-1].summary_crc
    named = [record for record in records if isinstance(record, Metadata)]
    assert [record.name for record in named] == ['rosbag2', 'provenance', 'rosbag2']
    first, last = (yaml.safe_load(named[i].metadata['serialized_metadata']) for i in (0, 2))
    assert (first['message_count'], first['starting_time']) == (
        0, {'nanoseconds_since_epoch': 2 ** 63 - 1})
    assert last == yaml.safe_load(
        (tmp_path / 'bag' / 'metadata.yaml').read_text())['rosbag2_bagfile_information']
    channels = [record for record in records if isinstance(record, Channel)]
    for channel in channels:
        assert channel.message_encoding == 'cdr'
        assert list(channel.metadata) == ['offered_qos_profiles', 'topic_type_hash']


def test_metadata_has_every_key_of_version_9(tmp_path):
    small_bag(tmp_path / 'bag', custom_data={'model': 'abc'})
    body = yaml.safe_load((tmp_path / 'bag' / 'metadata.yaml').read_text())[
        'rosbag2_bagfile_information']
    assert body['version'] == 9
    assert body['storage_identifier'] == 'mcap'
    assert body['starting_time'] == {'nanoseconds_since_epoch': 1000}
    assert body['duration'] == {'nanoseconds': 1990}
    assert body['message_count'] == 400
    assert body['relative_file_paths'] == ['bag_0.mcap']
    assert body['files'] == [{
        'path': 'bag_0.mcap', 'starting_time': {'nanoseconds_since_epoch': 1000},
        'duration': {'nanoseconds': 1990}, 'message_count': 400}]
    assert body['custom_data'] == {'model': 'abc'}
    assert (body['compression_format'], body['compression_mode']) == ('', '')
    assert body['ros_distro'] == 'jazzy'
    topic = body['topics_with_message_count'][0]
    assert topic['message_count'] == 200
    assert topic['topic_metadata'] == {
        'name': '/clock', 'type': 'rosgraph_msgs/msg/Clock', 'serialization_format': 'cdr',
        'type_description_hash':
            'RIHS01_692f7a66e93a3c83e71765d033b60349ba68023a8c689a79e48078bcb5c58564',
        'offered_qos_profiles': [{
            'history': 'unknown', 'depth': 0, 'reliability': 'reliable',
            'durability': 'volatile',
            'deadline': {'sec': 9223372036, 'nsec': 854775807},
            'lifespan': {'sec': 9223372036, 'nsec': 854775807}, 'liveliness': 'automatic',
            'liveliness_lease_duration': {'sec': 9223372036, 'nsec': 854775807},
            'avoid_ros_namespace_conventions': False}]}


def test_metadata_round_trip():
    small = BagMetadata(custom_data={'text': 'with: colons\nand lines', 'é': '☃'})
    assert metadata_from_text(metadata_to_text(small), 'test') == small


def test_schemas_hold_their_dependencies_and_hash():
    schema = schema_of('sensor_msgs/msg/Image')
    parts = schema.text.split('\n' + '=' * 80 + '\n')
    assert [part.splitlines()[0] for part in parts[1:]] == [
        'MSG: std_msgs/Header', 'MSG: builtin_interfaces/Time']
    assert schema.type_hash == (
        'RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47')
    diagnostics = schema_of('diagnostic_msgs/msg/DiagnosticArray').text
    assert diagnostics.count('MSG: diagnostic_msgs/DiagnosticStatus\n') == 1
    assert diagnostics.count('MSG: diagnostic_msgs/KeyValue\n') == 1
    unknown = schema_of('nobody_msgs/msg/Nothing')
    assert (unknown.encoding, unknown.text, unknown.type_hash) == ('', '', '')
    assert schema_of('../../etc/msg/passwd').text == ''


def test_schemas_are_enough_to_decode_every_topic(tmp_path):
    record_drive(tmp_path / 'bag', episodes=1, decisions=5)
    with (tmp_path / 'bag' / 'bag_0.mcap').open('rb') as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        kinds = {}
        for item in reader.iter_decoded_messages():
            kinds[item.channel.topic] = item.decoded_message
    assert kinds['/image_raw'].width == 96
    assert kinds['/step'].name[0] == 'reward'
    assert kinds['/cmd_vel'].twist.linear.x == pytest.approx(0.4)
    assert set(kinds) == {'/image_raw', '/step', '/reward', '/episode', '/cmd_vel', '/q_values',
                          '/clock'}


def test_qos_is_read_in_names_and_in_the_numbers_of_older_versions():
    latched = offered_qos(latched=True, depth=1)
    assert qos_from_text(qos_to_text([latched])) == [latched]
    old = ('- history: 3\n  depth: 0\n  reliability: 2\n  durability: 1\n'
           '  deadline: {sec: 1, nsec: 5}\n  lifespan: {sec: 9223372036, nsec: 854775807}\n'
           '  liveliness: 1\n  liveliness_lease_duration: {sec: 9223372036, nsec: 854775807}\n'
           '  avoid_ros_namespace_conventions: false')
    profile, = qos_from_text(old)
    assert profile['history'] == 'unknown'
    assert profile['reliability'] == 'best_effort'
    assert profile['durability'] == 'transient_local'
    assert profile['deadline'] == {'sec': 1, 'nsec': 5}
    for bad in ('{', 'a: 1', '- 3', '- {depth: x}', '- {deadline: 7}'):
        with pytest.raises(BagError):
            qos_from_text(bad)


def test_splitting_by_size_loses_nothing_and_every_file_stands_alone(tmp_path):
    written = small_bag(tmp_path / 'bag', split_bytes=8000, messages=600)
    files = sorted((tmp_path / 'bag').glob('*.mcap'),
                   key=lambda path: int(path.stem.split('_')[1]))
    assert [path.name for path in files] == [f'bag_{i}.mcap' for i in range(len(files))]
    assert len(files) > 3
    with BagReader(tmp_path / 'bag') as reader:
        assert read_all(reader) == written
    assert read_with_rosbags(tmp_path / 'bag') == [(one[0], one[1], one[3]) for one in written]
    total = 0
    for path in files:
        with BagReader(path) as reader:
            total += reader.message_count
            assert set(reader.topics) == {'/clock', '/reward'}
            assert path.stat().st_size < 20_000
    assert total == len(written)
    assert sum(file.message_count for file in read_metadata(tmp_path / 'bag').files) == total


def test_a_bag_of_more_files_than_may_be_open_is_read(tmp_path):
    small_bag(tmp_path / 'bag', split_bytes=1, messages=30, chunk_bytes=1)
    script = textwrap.dedent("""
        import resource, sys
        sys.path.insert(0, sys.argv[2])
        from bags.reader import BagReader
        from bags.recover import recover_bag
        from bags.verify import verify_bag
        resource.setrlimit(resource.RLIMIT_NOFILE, (40, 40))
        with BagReader(sys.argv[1]) as reader:
            print(len(reader.files), sum(1 for _ in reader.messages()), verify_bag(reader).good)
        print(recover_bag(sys.argv[1], sys.argv[1] + '_saved').messages)
    """)
    told = subprocess.run(
        [sys.executable, '-c', script, str(tmp_path / 'bag'), str(ROOT)],
        capture_output=True, text=True, timeout=60, check=True).stdout
    assert told.split() == ['60', '60', 'True', '60']


def test_a_file_that_is_replaced_before_its_turn_is_none_of_the_bag(tmp_path):
    small_bag(tmp_path / 'bag', split_bytes=1, messages=10, chunk_bytes=1)
    with BagReader(tmp_path / 'bag') as reader:
        messages = reader.messages()
        next(messages)
        last = reader.files[-1]
        shutil.copy(last, tmp_path / 'other')
        (tmp_path / 'other').replace(last)
        with pytest.raises(BagError, match=f'{last.name} was replaced meanwhile'):
            list(messages)


def test_splitting_by_time(tmp_path):
    written = small_bag(tmp_path / 'bag', split_seconds=500e-9, messages=200)
    metadata = read_metadata(tmp_path / 'bag')
    assert len(metadata.files) == 4
    assert all(file.duration < 500 for file in metadata.files)
    with BagReader(tmp_path / 'bag') as reader:
        assert read_all(reader) == written
        part = [one for one in written if 1400 <= one[1] < 1600]
        found = list(reader.messages(['/clock'], 1400, 1600))
        assert [bytes(one.data) for one in found] == [one[3] for one in part
                                                      if one[0] == '/clock']


def test_messages_of_time_zero_are_no_empty_chunk(tmp_path):
    data = serialized('std_msgs/msg/Float32', 1.0)
    with BagWriter(tmp_path / 'bag') as writer:
        topic = writer.add_topic('/reward', 'std_msgs/msg/Float32', [offered_qos()])
        # simulation time before /clock moves, and a file that comes after it
        for times in (range(10, 15), [0] * 5):
            for time in times:
                writer.write(topic, time, 0, data)
            writer.next_file()
    with BagReader(tmp_path / 'bag') as reader:
        assert (reader.start_time, reader.end_time) == (0, 14)
        assert [one.log_time for one in reader.messages(start=reader.start_time)] == [
            *[0] * 5, *range(10, 15)]


def test_an_existing_folder_is_refused_and_untouched(tmp_path):
    small_bag(tmp_path / 'bag')
    before = {path.name: path.read_bytes() for path in (tmp_path / 'bag').iterdir()}
    with pytest.raises(BagError, match='exists already; nothing was overwritten'):
        BagWriter(tmp_path / 'bag')
    assert {path.name: path.read_bytes() for path in (tmp_path / 'bag').iterdir()} == before


def test_a_bad_compression_leaves_no_folder(tmp_path):
    with pytest.raises(BagError, match="'gzip'; accepted: none, lz4, zstd"):
        BagWriter(tmp_path / 'bag', compression='gzip')
    assert not (tmp_path / 'bag').exists()


def test_an_empty_bag_is_a_bag(tmp_path):
    BagWriter(tmp_path / 'bag').close()
    with BagReader(tmp_path / 'bag') as reader:
        assert read_all(reader) == []
        assert reader.message_count == 0
    assert read_with_rosbags(tmp_path / 'bag') == []


def test_a_killed_writer_risks_at_most_one_chunk_or_one_second(tmp_path):
    now = [0.0]
    writer = BagWriter(tmp_path / 'bag', chunk_bytes=4096, clock=lambda: now[0])
    topic = writer.add_topic('/reward', 'std_msgs/msg/Float32', [offered_qos()])
    data = serialized('std_msgs/msg/Float32', 1.0)

    def on_disk():
        with McapFile(tmp_path / 'bag' / 'bag_0.mcap', strict=False) as file:
            return sum(len(file.span_messages(span)) for span in file.spans)

    for number in range(300):
        writer.write(topic, number, number, data)
        assert number + 1 - on_disk() <= 4096 // (31 + len(data)) + 1
    waiting = 300 - on_disk()
    assert waiting > 0
    writer.tick()
    assert 300 - on_disk() == waiting
    now[0] = 1.0
    writer.tick()
    assert on_disk() == 300
    # and the origin of the run is there from the start
    writer.close()


def test_a_full_disk_leaves_a_bag_of_whole_chunks(tmp_path):
    script = textwrap.dedent("""
        import resource, sys
        sys.path[:0] = sys.argv[2:]
        from bag_cases import serialized
        from bags.recording import Recording
        from bags.writer import BagWriter
        from bags.errors import BagError
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
        recording = Recording(BagWriter(sys.argv[1], compression='none', chunk_bytes=20_000), 1e8)
        topic = recording.add_topic('/reward', 'std_msgs/msg/Float32', [])
        data = serialized('std_msgs/msg/Float32', 1.0)
        for number in range(5000):
            recording.put([(number, number, topic, data)])
        try:
            recording.close()
        except BagError as error:
            print(error)
    """)
    told = subprocess.run(
        [sys.executable, '-c', script, str(tmp_path / 'bag'), str(ROOT), str(ROOT / 'tests')],
        capture_output=True, text=True, timeout=60, check=True).stdout
    with BagReader(tmp_path / 'bag') as reader:
        kept = reader.message_count
        assert [one.log_time for one in reader.messages()] == list(range(kept))
    assert 1000 < kept < 3000
    assert 'File too large' in told
    assert f'{kept} messages are in the bag, {5000 - kept} were lost' in told


def test_images_are_read_into_arrays(tmp_path):
    record_drive(tmp_path / 'bag', episodes=2, decisions=10)
    with BagReader(tmp_path / 'bag') as reader:
        stamps, frames = load_images(reader)
        assert frames.shape == (22, 96, 96, 3)
        for number, (stamp, pixels) in enumerate(bag_images(reader)):
            assert stamp == stamps[number]
            assert np.array_equal(frames[number], pixels)
            assert not pixels.flags.writeable
        with pytest.raises(BagError, match="has no topic '/nowhere'"):
            load_images(reader, topic='/nowhere')
        with pytest.raises(BagError, match='is of type sensor_msgs/msg/JointState'):
            load_images(reader, topic='/step')
