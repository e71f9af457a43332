# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Bags that are cut off, damaged or hostile: clear errors, bounded memory, nothing made up."""
import contextlib
import os
from pathlib import Path
import resource
import shutil
import subprocess
import sys
import tracemalloc
import zlib

from bag_cases import clock, read_all, serialized, small_bag
from bags.compression import unpack
from bags.errors import BagError
from bags.mcap_file import McapFile
from bags.mcap_records import HEAD, MAGIC, record_bytes
from bags.metadata import metadata_from_text, read_metadata
from bags.qos_text import offered_qos
from bags.reader import BagReader
from bags.recover import recover_bag
from bags.salvage import BLOCK_BYTES
from bags.verify import verify_bag
from bags.writer import BagWriter, MOST_TOPICS
from hypothesis import given, HealthCheck, settings, strategies
import lz4.frame
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import (
    Channel, Chunk, DataEnd, Footer, Header, Message, MessageIndex, Schema,
)
from mcap.writer import CompressionType, Writer
import numpy as np
import pytest
from rosbags.rosbag2 import Reader
import zstandard

FEW = settings(max_examples=60, deadline=None,
               suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture(scope='module')
def small(tmp_path_factory):
    """Return a bag of several chunks: its folder, its bytes, and the messages in it."""
    folder = tmp_path_factory.mktemp('small') / 'bag'
    written = small_bag(folder, compression='lz4', custom_data={'seed': '7'})
    return folder, (folder / 'bag_0.mcap').read_bytes(), written


def record_boundaries(data: bytes) -> list[int]:
    """Return where each top-level record begins, and where the last one ends."""
    position, found = len(MAGIC), []
    while position < len(data) - len(MAGIC):
        found.append(position)
        position += HEAD.size + HEAD.unpack_from(data, position)[1]
    return [*found, position]


def whole_messages(data: bytes, cut: int) -> int:
    """Return how many messages are in chunks that end before a cut."""
    count = 0
    for position in record_boundaries(data):
        opcode, length = HEAD.unpack_from(data, position) if position < len(data) - 8 else (0, 0)
        if opcode == Opcode.CHUNK and position + HEAD.size + length <= cut:
            count += chunk_count(data, position)
    return count


def chunk_count(data: bytes, position: int) -> int:
    """Return the messages of the chunk record at a position, from its message index."""
    position += HEAD.size + HEAD.unpack_from(data, position)[1]
    count = 0
    while data[position] == Opcode.MESSAGE_INDEX:
        length = HEAD.unpack_from(data, position)[1]
        count += (length - 6) // 16
        position += HEAD.size + length
    return count


def check_cut(data: bytes, written: list, cut: int, folder: Path) -> None:
    """A file cut off at a byte is refused, and recovered to its last whole chunk."""
    folder.mkdir(exist_ok=True)
    source, target = folder / 'cut.mcap', folder / 'out'
    shutil.rmtree(target, ignore_errors=True)
    source.write_bytes(data[:cut])
    with pytest.raises(BagError) as told:
        BagReader(source)
    assert '\n' not in str(told.value)
    header_end = record_boundaries(data)[1]
    if cut < header_end:
        with pytest.raises(BagError):
            recover_bag(source, target)
        assert not target.exists()
        return
    recovery = recover_bag(source, target)
    expected = written[:whole_messages(data, cut)]
    assert recovery.messages == len(expected)
    with BagReader(target) as reader:
        assert read_all(reader) == expected
        assert reader.problems == []
        # the origin of the run survives, once its record is in the file
        if cut >= record_boundaries(data)[3]:
            assert reader.custom_data == {'seed': '7'}
    with Reader(target) as reader:
        assert sum(1 for _ in reader.messages()) == len(expected)


def test_cut_off_at_every_record_boundary(small, tmp_path):
    _, data, written = small
    boundaries = record_boundaries(data)
    assert len(boundaries) > 30
    for boundary in boundaries:
        check_cut(data, written, boundary, tmp_path)


@FEW
@given(share=strategies.floats(0, 1, exclude_max=True))
def test_cut_off_anywhere(small, tmp_path, share):
    _, data, written = small
    check_cut(data, written, int(share * len(data)), tmp_path)


def test_a_killed_recording_of_several_files_is_recovered(tmp_path):
    written = small_bag(tmp_path / 'bag', split_bytes=8000)
    (tmp_path / 'bag' / 'metadata.yaml').unlink()
    files = sorted((tmp_path / 'bag').glob('*.mcap'))
    last = files[-1].read_bytes()
    files[-1].write_bytes(last[:len(last) // 2])
    with pytest.raises(BagError, match='carracing bag recover'):
        BagReader(tmp_path / 'bag')
    before = [path.read_bytes() for path in files]
    recovery = recover_bag(tmp_path / 'bag', tmp_path / 'out')
    assert [path.read_bytes() for path in files] == before
    with BagReader(tmp_path / 'out') as reader:
        found = read_all(reader)
        assert len(reader.files) == len(files)
    assert found == written[:len(found)]
    assert 0 < recovery.messages == len(found) < len(written)
    assert recovery.lost_bytes > 0
    with pytest.raises(BagError, match='exists already'):
        recover_bag(tmp_path / 'bag', tmp_path / 'out')


def test_a_damaged_chunk_costs_only_itself(small, tmp_path):
    _, data, written = small
    with McapFile(small[0] / 'bag_0.mcap') as file:
        span = file.spans[2]
        before = sum(len(file.span_messages(one)) for one in file.spans[:2])
        inside = len(file.span_messages(span))
    broken = bytearray(data)
    broken[span.offset + span.length // 2] ^= 0x10
    (tmp_path / 'broken.mcap').write_bytes(broken)
    recovery = recover_bag(tmp_path / 'broken.mcap', tmp_path / 'out')
    assert recovery.bad_chunks == 1
    with BagReader(tmp_path / 'out') as reader:
        assert read_all(reader) == written[:before] + written[before + inside:]


@settings(FEW, max_examples=150)
@given(share=strategies.floats(0, 1, exclude_max=True), bit=strategies.integers(0, 7))
def test_verify_finds_one_flipped_bit_anywhere_in_the_file(small, tmp_path, share, bit):
    folder, data, _ = small
    broken = bytearray(data)
    broken[int(share * len(data))] ^= 1 << bit
    target = tmp_path / 'bag'
    shutil.copytree(folder, target, dirs_exist_ok=True)
    (target / 'bag_0.mcap').write_bytes(broken)
    try:
        with BagReader(target) as reader:
            problems = verify_bag(reader).problems
    except BagError:
        return
    assert problems


def test_verify_finds_nothing_in_a_good_bag(small):
    with BagReader(small[0]) as reader:
        assert verify_bag(reader).problems == []


def test_verify_finds_a_changed_metadata_yaml(small, tmp_path):
    target = tmp_path / 'bag'
    shutil.copytree(small[0], target)
    text = (target / 'metadata.yaml').read_text()
    (target / 'metadata.yaml').write_text(text.replace("seed: '7'", "seed: '8'"))
    with BagReader(target) as reader:
        assert verify_bag(reader).problems == [
            'metadata.yaml differs from its copy in the last file']


def test_not_an_mcap_file(tmp_path):
    for content in (b'', b'hello', MAGIC[:-1] + b'x' * 100, bytes(1000)):
        path = tmp_path / 'bad.mcap'
        path.write_bytes(content)
        with pytest.raises(BagError, match='is not an MCAP file'):
            BagReader(path)
    with pytest.raises(BagError, match='does not exist'):
        BagReader(tmp_path / 'nothing')
    with pytest.raises(BagError, match='has no metadata.yaml'):
        BagReader(tmp_path)


def test_another_profile_is_refused(tmp_path):
    path = tmp_path / 'other.mcap'
    with path.open('wb') as file:
        writer = Writer(file)
        writer.start(profile='ros1')
        writer.finish()
    with pytest.raises(BagError, match="has profile 'ros1'; accepted: 'ros2'"):
        BagReader(path)


def foreign_bag(path, *, schema_encoding='ros2msg', message_encoding='cdr', times=(30, 10, 20),
                type_name='nobody_msgs/msg/Nothing', text=b'int32 x', data=b'\0\1\0\0',
                **options):
    with path.open('wb') as file:
        writer = Writer(file, **{'compression': CompressionType.NONE, **options})
        writer.start(profile='ros2')
        schema = writer.register_schema(type_name, schema_encoding, text)
        channel = writer.register_channel('/image_raw', message_encoding, schema)
        for time in times:
            writer.add_message(channel, time, data, time)
        writer.finish()


def test_unknown_types_and_encodings_are_read_as_bytes_but_not_decoded(tmp_path):
    path = tmp_path / 'foreign.mcap'
    foreign_bag(path, schema_encoding='protobuf', message_encoding='json')
    with BagReader(path) as reader:
        assert [one.log_time for one in reader.messages()] == [10, 20, 30]
        assert reader.topics['/image_raw'].encoding == 'json'
        assert verify_bag(reader).good
    foreign_bag(path, type_name='sensor_msgs/msg/Image', data=b'\0\1\0\0\5')
    from bags.image_arrays import load_images
    with BagReader(path) as reader, pytest.raises(BagError, match='is not a sensor_msgs'):
        load_images(reader)


@pytest.mark.parametrize('options', [
    {'use_chunking': False}, {'use_statistics': False}, {'repeat_channels': False},
    {'repeat_schemas': False, 'repeat_channels': False, 'use_statistics': False},
    {'use_summary_offsets': False, 'enable_crcs': False}])
def test_mcap_files_of_other_writers_are_read(tmp_path, options):
    path = tmp_path / 'foreign.mcap'
    foreign_bag(path, **options)
    with BagReader(path) as reader:
        assert [one.log_time for one in reader.messages()] == [10, 20, 30]
        assert reader.message_count == 3
        assert verify_bag(reader).good


def hostile(path: Path, chunk: Chunk) -> None:
    """Write a complete MCAP file around one chunk."""
    body = b''.join(map(record_bytes, (Header(profile='ros2', library=''), chunk, DataEnd(0))))
    path.write_bytes(MAGIC + body + record_bytes(Footer(0, 0, 0)) + MAGIC)


def test_a_chunk_that_claims_gigabytes_is_refused_without_making_them(tmp_path):
    zeros = bytes(50_000_000)
    bombs = {
        # (compression, packed bytes, size it claims)
        'claims too much': ('zstd', zstandard.compress(b'x'), 1 << 40),
        'zstd holds more than it claims': ('zstd', zstandard.compress(zeros), 100),
        'lz4 holds more than it claims': ('lz4', lz4.frame.compress(zeros), 100),
        'lz4 holds less than it claims': ('lz4', lz4.frame.compress(b'abc'), 200 << 20),
        'plain and too short': ('', b'abc', 1000),
        'not packed at all': ('lz4', b'abcdefgh', 100),
        'unknown': ('br', b'abc', 3),
    }
    stream = zstandard.ZstdCompressor(write_content_size=False)
    bombs['zstd does not say'] = ('zstd', stream.compress(zeros), 100)
    for name, (compression, packed, size) in bombs.items():
        path = tmp_path / 'bomb.mcap'
        hostile(path, Chunk(
            compression=compression, data=packed, message_start_time=0, message_end_time=1,
            uncompressed_crc=0, uncompressed_size=size))
        tracemalloc.start()
        with pytest.raises(BagError):
            BagReader(path)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 20_000_000, name


def test_records_inside_a_chunk_that_lie_about_their_length(tmp_path):
    good = record_bytes(Message(channel_id=1, log_time=1, data=b'', publish_time=1, sequence=0))
    for inside in (good[:-5], HEAD.pack(5, 1 << 60) + bytes(30), HEAD.pack(5, 3) + bytes(3),
                   b'\5'):
        path = tmp_path / 'bad.mcap'
        hostile(path, Chunk(
            compression='', data=inside, message_start_time=0, message_end_time=1,
            uncompressed_crc=zlib.crc32(inside), uncompressed_size=len(inside)))
        with pytest.raises(BagError, match='is damaged'):
            BagReader(path)


def test_messages_of_a_channel_without_a_name(tmp_path):
    inside = record_bytes(
        Message(channel_id=9, log_time=1, data=b'', publish_time=1, sequence=0))
    path = tmp_path / 'bad.mcap'
    hostile(path, Chunk(
        compression='', data=inside, message_start_time=1, message_end_time=1,
        uncompressed_crc=0, uncompressed_size=len(inside)))
    with pytest.raises(BagError, match='channel 9, which it never names'):
        BagReader(path)


def chunk_of(*times, data=b'', first=None, last=None):
    """Return a chunk with a message of /t at each time; first and last are what it says."""
    inside = b''.join(map(record_bytes, (
        Schema(id=1, data=b'', encoding='', name='t'),
        Channel(id=1, topic='/t', message_encoding='cdr', metadata={}, schema_id=1),
        *(Message(channel_id=1, log_time=time, data=data, publish_time=time, sequence=0)
          for time in times))))
    return Chunk(
        compression='', data=inside, message_start_time=min(times) if first is None else first,
        message_end_time=max(times) if last is None else last,
        uncompressed_crc=zlib.crc32(inside), uncompressed_size=len(inside))


@pytest.mark.parametrize(('first', 'last'), [(20, 30), (1, 10), (12, 30), (0, 0)])
def test_a_chunk_that_lies_about_its_time_is_not_played_without_its_messages(
    tmp_path, first, last,
):
    path = tmp_path / 'lie.mcap'
    hostile(path, chunk_of(10, 12, 11, first=first, last=last))
    with BagReader(path) as reader:
        assert any('another time than its messages' in one for one in verify_bag(reader).problems)
        with pytest.raises(BagError, match='bag recover` writes it anew'):
            list(reader.messages(start=reader.start_time))
    assert recover_bag(path, tmp_path / 'saved').messages == 3
    with BagReader(tmp_path / 'saved') as reader:
        assert [one.log_time for one in reader.messages(start=reader.start_time)] == [10, 11, 12]


def test_a_chunk_of_nothing_but_empty_messages_takes_no_more_memory_than_a_few_times_its_size(
    tmp_path,
):
    path, count = tmp_path / 'empty.mcap', 20_000
    hostile(path, chunk_of(*[2] * (count // 2), *[1] * (count // 2)))
    tracemalloc.start()
    with BagReader(path) as reader:
        assert sum(1 for _ in reader.messages()) == reader.message_count == count
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 3 * path.stat().st_size


@pytest.mark.parametrize('change', [sorted, lambda entries: entries[::-1], lambda entries: [
    *entries[:2], (5, 7), *entries[3:]]])
def test_an_index_may_be_in_another_order_but_not_of_other_messages(tmp_path, change):
    chunk = chunk_of(30, 10, 20)
    places = [place for place in record_boundaries(MAGIC + chunk.data + MAGIC)[2:5]]
    entries = change([(time, place - len(MAGIC)) for time, place in zip((30, 10, 20), places)])
    body = b''.join(map(record_bytes, (
        Header(profile='ros2', library=''), chunk, MessageIndex(channel_id=1, records=entries),
        MessageIndex(channel_id=2, records=[]), DataEnd(0))))
    path = tmp_path / 'index.mcap'
    path.write_bytes(MAGIC + body + record_bytes(Footer(0, 0, 0)) + MAGIC)
    with BagReader(path) as reader:
        assert verify_bag(reader).good == ((5, 7) not in entries)


def test_chunks_that_overlap_come_out_in_order_of_time(tmp_path):
    head = record_bytes(Schema(id=1, data=b'', encoding='', name='t')) + record_bytes(
        Channel(id=1, topic='/t', message_encoding='cdr', metadata={}, schema_id=1))
    body = record_bytes(Header(profile='ros2', library='')) + head
    for times in ((0, 50, 100), (10, 60), (55, 5), (200, 150), (1, 300)):
        inside = b''.join(record_bytes(Message(
            channel_id=1, log_time=time, data=clock(time), publish_time=time, sequence=0))
            for time in times)
        body += record_bytes(Chunk(
            compression='', data=inside, message_start_time=min(times),
            message_end_time=max(times), uncompressed_crc=0, uncompressed_size=len(inside)))
    path = tmp_path / 'overlap.mcap'
    path.write_bytes(MAGIC + body + record_bytes(DataEnd(0)) + record_bytes(Footer(0, 0, 0))
                     + MAGIC)
    expected = sorted((0, 50, 100, 10, 60, 55, 5, 200, 150, 1, 300))
    with BagReader(path) as reader:
        assert [one.log_time for one in reader.messages()] == expected
        assert [one.log_time for one in reader.messages(start=10, stop=150)] == [
            time for time in expected if 10 <= time < 150]
    with path.open('rb') as file:
        assert [one.log_time for _, _, one in make_reader(file).iter_messages()] == expected


def test_metadata_that_lies_about_counts_is_said_and_the_files_count(small, tmp_path):
    target = tmp_path / 'bag'
    shutil.copytree(small[0], target)
    text = (target / 'metadata.yaml').read_text()
    text = text.replace('message_count: 400', 'message_count: 999').replace('/clock', '/lock')
    (target / 'metadata.yaml').write_text(text)
    with BagReader(target) as reader:
        assert reader.message_count == 400
        assert sum(1 for _ in reader.messages()) == 400
        assert reader.problems == [
            'metadata.yaml says 999 messages, the files hold 400',
            'metadata.yaml says there is /lock, there is not',
            'metadata.yaml does not name the topic /clock']
        assert not verify_bag(reader).good


@pytest.mark.parametrize(('old', 'new', 'told'), [
    ('bag_0.mcap', 'bag_7.mcap', 'names bag_7.mcap, which is not there'),
    ('bag_0.mcap', '/etc/passwd', 'which is not inside the bag'),
    ('bag_0.mcap', '../other.mcap', 'which is not inside the bag'),
    ('- bag_0.mcap', '- bag_0.mcap\n  - other/bag_0.mcap', 'names a file twice'),
    ("seed: '7'", 'seed: "\\ud800"', 'half a surrogate pair'),
    ('version: 9', 'version: 10', 'is of version 10; accepted: 1 to 9'),
    ('version: 9', 'version: x', "version is 'x'; expected a whole number"),
    ('storage_identifier: mcap', 'storage_identifier: tape', "storage 'tape'; accepted: mcap"),
    ('message_count: 400', 'message_count: -3', 'message_count is -3'),
    ('topics_with_message_count', 'topics', "lacks the key 'topics_with_message_count'"),
    ("compression_mode: ''", 'compression_mode: FILE', 'compressed file by file'),
    ('rosbag2_bagfile_information:', 'rosbag2_bagfile_information: 3\nx:', 'not laid out'),
    ('relative_file_paths:', 'relative_file_paths: {{', 'is not valid YAML'),
    ('custom_data:', 'a: &a [1]\nb: [*a, *a]\ncustom_data:', 'is not valid YAML'),
])
def test_metadata_that_cannot_be_believed(small, tmp_path, old, new, told):
    target = tmp_path / 'bag'
    shutil.copytree(small[0], target)
    text = (target / 'metadata.yaml').read_text()
    assert old in text
    (target / 'metadata.yaml').write_text(text.replace(old, new))
    with pytest.raises(BagError) as error:
        BagReader(target)
    assert told in str(error.value)
    assert '\n' not in str(error.value)


def test_metadata_that_is_too_large_too_deep_or_unsafe():
    for text in ('[' * 100_000, '!!python/object/apply:os.system ["true"]', 'x' * (5 << 20),
                 'a: ' + '{a: ' * 5000, '\0', '2024-99-99'):
        with pytest.raises(BagError):
            metadata_from_text(text, 'test')


@settings(FEW, max_examples=100)
@given(data=strategies.binary(max_size=300), size=strategies.integers(0, 1000),
       compression=strategies.sampled_from(['', 'lz4', 'zstd', 'other']))
def test_unpacking_anything_gives_the_size_it_says_or_an_error(data, size, compression):
    with contextlib.suppress(BagError):
        assert len(unpack(compression, data, size)) == size


@settings(FEW, max_examples=100)
@given(changes=strategies.lists(
    strategies.tuples(strategies.integers(0, 20_000), strategies.binary(
        min_size=1, max_size=9)), min_size=1, max_size=5))
def test_a_scribbled_file_raises_nothing_but_our_error(small, tmp_path, changes):
    data = bytearray(small[1])
    for position, scribble in changes:
        position %= len(data)
        data[position:position + len(scribble)] = scribble[:len(data) - position]
    path = tmp_path / 'scribbled.mcap'
    path.write_bytes(data)
    with contextlib.suppress(BagError), BagReader(path) as reader:
        for _ in reader.messages():
            pass
    shutil.rmtree(tmp_path / 'out', ignore_errors=True)
    with contextlib.suppress(BagError):
        recover_bag(path, tmp_path / 'out')


def ranges(data, place, length, how, random):
    """Damage a range of bytes in the middle of a file."""
    start = int(place * len(data))
    stop = min(start + length, len(data))
    if how == 'deleted':
        return data[:start] + data[stop:]
    if how == 'inserted':
        return data[:start] + random.bytes(length) + data[start:]
    if how == 'duplicated':
        return data[:stop] + data[start:]
    if how == 'swapped':
        return data[:start] + data[stop:stop + length] + data[start:stop] + data[stop + length:]
    return data[:start] + bytes(stop - start) + data[stop:]


@settings(deadline=None, max_examples=60)
@given(place=strategies.floats(0, 1), length=strategies.integers(1, 3000),
       how=strategies.sampled_from(['deleted', 'inserted', 'duplicated', 'swapped', 'zeroed']),
       seed=strategies.integers(0, 1000), block=strategies.sampled_from([80, 700, BLOCK_BYTES]))
def test_recovery_goes_on_behind_damage_and_keeps_every_chunk_that_is_whole(
    small, tmp_path_factory, place, length, how, seed, block,
):
    folder, data, written = small
    damaged = ranges(data, place, length, how, np.random.default_rng(seed))
    root = tmp_path_factory.mktemp('damaged')
    (root / 'damaged.mcap').write_bytes(damaged)
    with McapFile(folder / f'{folder.name}_0.mcap') as file:
        whole = {span: file.span_messages(span) for span in file.spans}
        names = {number: channel.topic for number, channel in file.channels.items()}
    kept = [message for span, messages in whole.items() for message in messages
            if data[span.record:span.offset + span.length] in damaged]
    expected = {(names[one.channel], one.log_time) for one in kept}
    try:
        # what is looked for may lie across two blocks
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr('bags.salvage.BLOCK_BYTES', block)
            recover_bag(root / 'damaged.mcap', root / 'saved')
    except BagError:
        assert not expected
        return
    with BagReader(root / 'saved') as reader:
        found = [(one.topic, one.log_time) for one in reader.messages()]
    # without its first chunk and its summary a file names no topics
    if found or not expected:
        assert expected <= set(found)
    assert len(set(found)) == len(found)


@pytest.mark.parametrize(('how', 'least'), [
    ({'use_chunking': False}, 0.9),
    ({'enable_crcs': False, 'compression': CompressionType.ZSTD}, 0.5),
    ({'enable_crcs': False, 'compression': CompressionType.NONE}, 0.8),
])
def test_recovery_goes_on_in_files_of_others_without_chunks_or_their_crc(
    tmp_path, how, least,
):
    foreign_bag(tmp_path / 'whole.mcap', times=range(1000, 1120), data=bytes(range(90)),
                chunk_size=700, **how)
    data = (tmp_path / 'whole.mcap').read_bytes()
    with BagReader(tmp_path / 'whole.mcap') as reader:
        whole = {(one.topic, one.log_time, bytes(one.data)) for one in reader.messages()}
    assert len(whole) == 120
    for place in range(1, 8):
        damaged = bytearray(data)
        start = len(data) * place // 10
        damaged[start:start + 100] = bytes(100)
        (tmp_path / 'damaged.mcap').write_bytes(damaged)
        recover_bag(tmp_path / 'damaged.mcap', tmp_path / f'saved{place}')
        with BagReader(tmp_path / f'saved{place}') as reader:
            found = [(one.topic, one.log_time, bytes(one.data)) for one in reader.messages()]
        assert len(set(found)) == len(found) > least * 120
        # what stands in no CRC can be damaged unseen, the two messages that were hit at most
        assert len(set(found) - whole) <= 2


def test_a_chunk_whose_head_is_damaged_is_found_by_the_index(small, tmp_path):
    folder, data, written = small
    with McapFile(folder / f'{folder.name}_0.mcap') as file:
        span = file.spans[1]
    for place in (span.record, span.record + 3, span.record + HEAD.size + 20, span.offset - 3):
        damaged = bytearray(data)
        damaged[place] ^= 0x50
        (tmp_path / 'damaged.mcap').write_bytes(damaged)
        recover_bag(tmp_path / 'damaged.mcap', tmp_path / f'saved{place}')
        with BagReader(tmp_path / f'saved{place}') as reader:
            assert read_all(reader) == written


def test_a_flip_in_the_header_loses_nothing(small, tmp_path):
    _, data, written = small
    for place in range(50):
        damaged = bytearray(data)
        damaged[place] ^= 0x10
        (tmp_path / 'flipped.mcap').write_bytes(damaged)
        recover_bag(tmp_path / 'flipped.mcap', tmp_path / f'saved{place}')
        with BagReader(tmp_path / f'saved{place}') as reader:
            assert reader.message_count == len(written)


@pytest.mark.parametrize('name', ['metadata.yaml', 'bag_0.mcap'])
def test_a_fifo_in_a_bag_is_no_bag(small, tmp_path, name):
    folder = tmp_path / 'bag'
    shutil.copytree(small[0], folder)
    (folder / name).unlink()
    os.mkfifo(folder / name)
    with pytest.raises(BagError, match='not a regular file|is not there'):
        BagReader(folder)


def test_a_file_made_of_beginnings_ends(tmp_path):
    record = HEAD.pack(Opcode.CHUNK, 0) + bytes(8) + b'\xff' * 8 + bytes(3) + b'\1' + bytes(4)
    record += b'\1\2\3\4' + bytes(4) + bytes(8)
    names = HEAD.pack(Opcode.SCHEMA, 100_000)
    path = tmp_path / 'beginnings.mcap'
    for piece in (record, names):
        path.write_bytes(MAGIC + piece * 20_000)
        with pytest.raises(BagError, match='nothing of it is whole'):
            recover_bag(path, tmp_path / 'saved')


def test_a_split_that_is_not_there_is_said_and_the_others_are_saved(tmp_path):
    written = small_bag(tmp_path / 'bag', split_bytes=6000)
    middle = tmp_path / 'bag' / 'bag_1.mcap'
    with BagReader(middle) as reader:
        lost = read_all(reader)
    middle.unlink()

    def saved(name):
        recovery = recover_bag(tmp_path / 'bag', tmp_path / name)
        with BagReader(tmp_path / name) as reader:
            assert read_all(reader) == [one for one in written if one not in lost]
        return recovery.remarks

    named = 'bag_1.mcap is not there as an .mcap file; nothing of it could be saved'
    assert saved('named in metadata.yaml') == [named]
    (tmp_path / 'bag' / 'metadata.yaml').unlink()
    assert saved('named in the last file') == ['there was no metadata.yaml', named]
    middle.symlink_to('/nowhere/bag_1.mcap')
    assert saved('dangling') == [
        f'{middle}: No such file or directory; nothing of it could be saved',
        'there was no metadata.yaml']


def test_a_gap_in_the_numbers_of_files_is_said(small, tmp_path):
    (tmp_path / 'bag').mkdir()
    # cut off: none of them says what other files there are
    for number in (0, 3):
        (tmp_path / 'bag' / f'bag_{number}.mcap').write_bytes(small[1][:-2000])
    assert recover_bag(tmp_path / 'bag', tmp_path / 'saved').remarks[-1] == (
        'between bag_0.mcap and bag_3.mcap files are missing: 2; nothing of them could be saved')


@pytest.mark.parametrize('name', ['metadata.yaml', None])
def test_what_came_to_a_bag_later_is_recovered_too(tmp_path, name):
    late = [offered_qos(), offered_qos(latched=True)]
    with BagWriter(tmp_path / 'bag', custom_data={'seed': '7'}, chunk_bytes=1024) as writer:
        topic = writer.add_topic('/reward', 'std_msgs/msg/Float32', [offered_qos()])
        for number in range(100):
            writer.write(topic, number, 0, serialized('std_msgs/msg/Float32', float(number)))
        writer.add_offers(topic, late)
        writer.note('lost_messages', '{"/reward": 18054}')
    path = tmp_path / 'bag' / 'bag_0.mcap'
    data = bytearray(path.read_bytes())
    with McapFile(path) as file:
        data[file.spans[1].offset] ^= 1
        if name:
            # the record at the end, so that metadata.yaml alone still says it
            data = data[:file.data_end[0] - 300]
    path.write_bytes(data)
    if not name:
        (tmp_path / 'bag' / 'metadata.yaml').unlink()
    assert recover_bag(tmp_path / 'bag', tmp_path / 'saved').bad_chunks == 1
    with BagReader(tmp_path / 'saved') as reader:
        assert reader.custom_data == {'seed': '7', 'lost_messages': '{"/reward": 18054}'}
        assert reader.topics['/reward'].qos == late


def test_log_times_before_the_epoch_make_one_file(tmp_path):
    times = range(2 ** 64 - 300, 2 ** 64)
    foreign_bag(tmp_path / 'negative.mcap', times=times)
    recover_bag(tmp_path / 'negative.mcap', tmp_path / 'saved')
    assert len(read_metadata(tmp_path / 'saved').files) == 1
    with BagReader(tmp_path / 'saved') as reader:
        assert [one.log_time for one in reader.messages()] == list(times)


def test_chunks_without_crc_that_say_the_same_of_themselves_are_all_saved(tmp_path):
    with (tmp_path / 'whole.mcap').open('wb') as file:
        writer = Writer(file, chunk_size=300, compression=CompressionType.ZSTD, enable_crcs=False)
        writer.start(profile='ros2')
        schema = writer.register_schema('std_msgs/msg/Float32', 'ros2msg', b'float32 data')
        channel = writer.register_channel('/reward', 'cdr', schema)
        for number in range(200):
            writer.add_message(
                channel, 1000, serialized('std_msgs/msg/Float32', float(number)), 1000)
        writer.finish()
    data = bytearray((tmp_path / 'whole.mcap').read_bytes())
    with BagReader(tmp_path / 'whole.mcap') as reader:
        whole = read_all(reader)
        first = reader.mcap_files[0].spans[0]
    # the length of the header, so that the chunks are searched, and one of them is there twice
    data[9] = 0xff
    data[first.record:first.record] = data[first.record:first.offset + first.length]
    (tmp_path / 'damaged.mcap').write_bytes(data)
    recover_bag(tmp_path / 'damaged.mcap', tmp_path / 'saved')
    with BagReader(tmp_path / 'saved') as reader:
        assert sorted(read_all(reader)) == sorted(whole)


def test_records_of_an_application_are_passed_over(small, tmp_path):
    folder, data, written = small
    with McapFile(folder / 'bag_0.mcap') as file:
        place = file.spans[2].record
    path = tmp_path / 'private.mcap'
    path.write_bytes(data[:place] + HEAD.pack(0x80, 4) + b'abcd' + data[place:])
    for strict in (True, False):
        with BagReader(path, strict=strict) as reader:
            assert read_all(reader) == written
            assert reader.problems == []
    recovery = recover_bag(path, tmp_path / 'saved')
    assert (recovery.lost_bytes, recovery.remarks) == (0, [])
    with BagReader(tmp_path / 'saved') as reader:
        assert read_all(reader) == written


def test_a_chunk_that_looks_like_a_record_of_an_application_is_found(small, tmp_path):
    folder, data, written = small
    with McapFile(folder / 'bag_0.mcap') as file:
        place = file.spans[2].record
    damaged = bytearray(data)
    damaged[place] ^= 0x80
    (tmp_path / 'damaged.mcap').write_bytes(damaged)
    recover_bag(tmp_path / 'damaged.mcap', tmp_path / 'saved')
    with BagReader(tmp_path / 'saved') as reader:
        assert read_all(reader) == written


def numbers_bag(folder, count=100, **options):
    """Write a bag of numbers; return its writer, still open."""
    writer = BagWriter(folder, **options)
    topic = writer.add_topic('/reward', 'std_msgs/msg/Float32', [offered_qos()])
    for number in range(count):
        writer.write(topic, number, 0, serialized('std_msgs/msg/Float32', float(number)))
    return writer


def test_a_bag_that_an_error_has_ended_is_not_there(tmp_path):
    with pytest.raises(KeyboardInterrupt), numbers_bag(tmp_path / 'bag', split_bytes=2000):
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(KeyboardInterrupt), numbers_bag(tmp_path / 'bag'):
        (tmp_path / 'bag').rename(tmp_path / 'elsewhere')
        small_bag(tmp_path / 'bag')
        raise KeyboardInterrupt
    with BagReader(tmp_path / 'bag') as reader:
        assert verify_bag(reader).good


def test_a_recovery_for_which_there_is_no_room_leaves_nothing(small, tmp_path):
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (5000, limit[1]))
    try:
        with pytest.raises(BagError, match='saved: File too large; nothing was kept of it'):
            recover_bag(small[0], tmp_path / 'saved')
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    assert list(tmp_path.iterdir()) == []


def test_a_bag_of_more_topics_than_can_be_read_again_is_not_recovered(tmp_path):
    path = tmp_path / 'many.mcap'
    path.write_bytes(MAGIC + record_bytes(Header(profile='ros2', library='')) + b''.join(
        record_bytes(Channel(id=number, topic=f'/t{number}', message_encoding='cdr', metadata={},
                             schema_id=0)) for number in range(1, MOST_TOPICS + 2))
        + record_bytes(DataEnd(0)) + record_bytes(Footer(0, 0, 0)) + MAGIC)
    with pytest.raises(BagError, match=f'a bag has {MOST_TOPICS} topics at most'):
        recover_bag(path, tmp_path / 'saved')
    assert not (tmp_path / 'saved').exists()


def test_no_bag_has_more_files_than_its_metadata_can_name(tmp_path, monkeypatch):
    monkeypatch.setattr('bags.writer.MOST_FILE_TEXT', 3000)
    numbers_bag(tmp_path / 'bag', split_bytes=1).close()
    with BagReader(tmp_path / 'bag') as reader:
        assert 5 < len(reader.files) < 3000 // 260
        assert [one.log_time for one in reader.messages()] == list(range(100))
        assert verify_bag(reader).problems == []
        # what is written for a file must not grow with the number of those before it
        sizes = [len(file.metadata['rosbag2']['serialized_metadata'])
                 for file in reader.mcap_files[:-1]]
    assert max(sizes) < min(sizes) + 20
    assert (tmp_path / 'bag' / 'metadata.yaml').stat().st_size < 3000 + 2000


def test_the_last_file_of_a_bag_may_have_the_first_time(tmp_path):
    writer = numbers_bag(tmp_path / 'bag', count=0)
    writer.write(0, 2000, 0, serialized('std_msgs/msg/Float32', 1.0))
    writer.next_file()
    writer.write(0, 1000, 0, serialized('std_msgs/msg/Float32', 2.0))
    writer.close()
    with BagReader(tmp_path / 'bag') as reader:
        assert verify_bag(reader).problems == []


def test_a_topic_whose_definition_changed_between_files_keeps_both(tmp_path):
    (tmp_path / 'bag').mkdir()
    for number in (0, 1):
        foreign_bag(tmp_path / 'bag' / f'bag_{number}.mcap', text=b'int32 x%d' % number,
                    times=[number])
    assert recover_bag(tmp_path / 'bag', tmp_path / 'saved').messages == 2
    with BagReader(tmp_path / 'saved') as reader:
        assert reader.message_count == 2
        found = [file.schemas[file.channels[message.channel].schema_id].data
                 for file in reader.mcap_files for message in file.messages()]
    assert found == [b'int32 x0', b'int32 x1']


def test_a_topic_of_two_encodings_is_no_topic(tmp_path):
    small_bag(tmp_path / 'bag', messages=1)
    for number, encoding in enumerate(('cdr', 'json')):
        foreign_bag(tmp_path / 'bag' / f'bag_{number}.mcap', message_encoding=encoding)
    (tmp_path / 'bag' / 'metadata.yaml').unlink()
    with pytest.raises(BagError, match='is encoded as json and as cdr'):
        BagReader(tmp_path / 'bag', strict=False)


@pytest.mark.parametrize('strict', [True, False])
def test_a_file_that_is_cut_short_while_it_is_opened_is_said(small, tmp_path, monkeypatch, strict):
    path = tmp_path / 'cut.mcap'
    path.write_bytes(small[1])
    scan = McapFile._scan

    def scan_what_was_cut(file, strict):
        path.write_bytes(b'')
        scan(file, strict)

    monkeypatch.setattr(McapFile, '_scan', scan_what_was_cut)
    with pytest.raises(BagError, match='was cut short meanwhile'):
        McapFile(path, strict=strict)


@pytest.mark.parametrize('change', ["b''", 'data[:-3000]', 'data[::-1]'])
def test_a_file_that_is_written_over_while_it_is_read_is_said(small, tmp_path, change):
    shutil.copytree(small[0], tmp_path / 'bag')
    # who reads a map of what was cut off is killed
    script = f"""if True:
        import itertools, pathlib, sys
        sys.path.insert(0, sys.argv[2])
        from bags.errors import BagError
        from bags.reader import BagReader
        path = pathlib.Path(sys.argv[1])
        with BagReader(path) as reader:
            messages = reader.messages()
            assert len(list(itertools.islice(messages, 10))) == 10
            file = path / 'bag_0.mcap'
            data = file.read_bytes()
            file.write_bytes({change})
            try:
                print(10 + len(list(messages)))
            except BagError as error:
                print(error)
    """
    told = subprocess.run(
        [sys.executable, '-c', script, str(tmp_path / 'bag'),
         str(Path(__file__).resolve().parents[1])],
        capture_output=True, text=True, timeout=60, check=True).stdout
    assert 'was cut short meanwhile' in told or 'chunk' in told or told == f'{len(small[2])}\n'
