# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Layouts are those of the tables, and each path in them is in a fresh bag; Rerun takes one."""
import json
from pathlib import Path
import re
from xml.etree import ElementTree

from bag_cases import record_drive
from bags.decode import decode_bundle
from bags.reader import BagReader
from carracing_dqn.watch.layouts import LAYOUTS, plotted
from graph_probe import carracing
import pytest

FOLDER = Path(__file__).resolve().parents[1] / 'layouts'


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    folder = tmp_path_factory.mktemp('layouts') / 'bag'
    record_drive(folder, episodes=1, decisions=10)
    return folder


@pytest.fixture(scope='module')
def names(bag):
    with BagReader(bag) as reader:
        message = next(reader.messages(['/step']))
        return reader.topics, decode_bundle(bytes(message.data), 'step').name


@pytest.mark.parametrize('name', list(LAYOUTS))
def test_the_files_are_those_of_the_tables(name):
    assert (FOLDER / name).read_text() == LAYOUTS[name](), (
        'run python -m carracing_dqn.watch.layouts layouts')


def test_each_path_of_foxglove_is_in_a_fresh_bag(names):
    topics, values = names
    panels = json.loads((FOLDER / 'foxglove.json').read_text())['configById']
    assert panels['Image!camera']['imageMode']['imageTopic'] in topics
    paths = [path for panel in panels.values() for path in panel.get('paths', ())]
    for path in paths:
        topic, place = re.fullmatch(r'(/\w+)\.position\[(\d+)\]', path['value']).groups()
        assert topic in topics and values[int(place)] == path['label']
    assert {path['label'] for path in paths} == set(plotted())


def test_each_path_of_plotjuggler_is_in_a_fresh_bag(names):
    topics, values = names
    curves = [curve.get('name') for curve in
              ElementTree.parse(FOLDER / 'plotjuggler.xml').iter('curve')]
    assert len(curves) > 5
    for curve in curves:
        _, topic, name, field = curve.split('/')
        assert f'/{topic}' in topics and name in values and field == 'position'


def test_rerun_takes_a_bag(bag, tmp_path):
    rerun = pytest.importorskip('rerun', reason="no rerun: pip install '.[rerun]'")
    file = tmp_path / 'lap.rrd'
    said = carracing('view', str(bag), '--save', str(file), timeout=120)
    assert said.returncode == 0, said.stderr
    assert said.stdout.startswith('11 frames') and file.stat().st_size > 10_000
    assert rerun.__version__
    again = carracing('view', str(bag), '--save', str(file))
    assert again.returncode == 2 and 'exists already' in again.stderr


def test_the_window_of_rerun_is_reached_from_this_host_alone(bag):
    pytest.importorskip('rerun', reason="no rerun: pip install '.[rerun]'")
    from carracing_dqn.watch import rerun_view
    viewer, address = rerun_view.start_viewer('--headless')
    try:
        port = int(address.rpartition(':')[2].partition('/')[0])
        # local addresses of listening sockets, IPv4 and IPv6, as the kernel writes them
        listening = [line.split()[1] for table in ('tcp', 'tcp6')
                     for line in Path(f'/proc/net/{table}').read_text().splitlines()
                     if line.split()[3] == '0A']
        assert [one for one in listening if one.endswith(f':{port:04X}')] == [
            f'0100007F:{port:04X}']
    finally:
        rerun_view.end_viewer(viewer)


def test_what_cannot_be_viewed_is_one_line(tmp_path):
    for words in ((), ('x', '--live'), (str(tmp_path / 'nothing'), '--save', 'x.rrd')):
        said = carracing('view', *words)
        assert said.returncode == 2 and said.stderr.count('\n') == 1, words
