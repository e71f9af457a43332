# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Layouts for Foxglove and PlotJuggler, made from the tables of topics and fields.

`python -m carracing_dqn.watch.layouts layouts` writes them anew; a test holds the files to the
tables, and each path in them to a fresh bag.
"""
from __future__ import annotations

from collections.abc import Iterator
import json
from pathlib import Path
import sys
from typing import Any, NamedTuple
from xml.etree import ElementTree

from carracing_sim_node import info_fields
from msgs_bridge.atomic_write import write_text
from msgs_bridge.step import STEP_CORE, STEP_INFO
from msgs_bridge.topics import IMAGE, STEP

COLOURS = ('#4e98e2', '#f5774d', '#5abe6e', '#c9a227')
# the order in which carracing_sim_node sends the values of `step`
STEP_NAMES = (*STEP_CORE, *info_fields.STEP_INFO, *STEP_INFO)


class Plot(NamedTuple):
    """A plot: its title and the values of `step` in it."""

    title: str
    values: tuple[str, ...]


PLOTS = (
    Plot('return', ('episode_return',)),
    Plot('reward', ('reward',)),
    Plot('speed', ('speed',)),
    Plot('controls', ('steer', 'gas', 'brake')),
    Plot('off the road', ('wheels_off_road', 'tiles_missed')),
)


def full(name: str) -> str:
    """Return the name of a topic outside of every namespace."""
    return name if name.startswith('/') else f'/{name}'


def foxglove() -> str:
    """Return a layout for Foxglove: values of a bundle go by their place in it."""
    panels: dict[str, Any] = {
        'Image!camera': {'imageMode': {'imageTopic': full(IMAGE.name)}},
        'StateTransitions!episode': {'paths': [{
            'value': f'{full(STEP.name)}.position[{STEP_NAMES.index("episode")}]',
            'label': 'episode', 'timestampMethod': 'receiveTime'}]},
    }
    for plot in PLOTS:
        panels[f'Plot!{plot.title.replace(" ", "_")}'] = {
            'title': plot.title, 'showLegend': True, 'followingViewWidth': 30,
            'paths': [{'value': f'{full(STEP.name)}.position[{STEP_NAMES.index(name)}]',
                       'label': name, 'enabled': True, 'timestampMethod': 'receiveTime',
                       'color': colour}
                      for name, colour in zip(plot.values, COLOURS)]}
    plots = [name for name in panels if name.startswith('Plot!')]
    return json.dumps({
        'configById': panels, 'globalVariables': {}, 'userNodes': {},
        'playbackConfig': {'speed': 1},
        'layout': {'direction': 'row', 'splitPercentage': 40,
                   'first': {'direction': 'column', 'splitPercentage': 80,
                             'first': 'Image!camera', 'second': 'StateTransitions!episode'},
                   'second': _column(plots)}}, indent=2) + '\n'


def _column(names: list[str]) -> Any:
    if len(names) == 1:
        return names[0]
    return {'direction': 'column', 'splitPercentage': 100 / len(names),
            'first': names[0], 'second': _column(names[1:])}


def plotjuggler() -> str:
    """Return a layout for PlotJuggler, which has the values of a JointState by their names."""
    root = ElementTree.Element('root')
    windows = ElementTree.SubElement(root, 'tabbed_widget', parent='main_window',
                                     name='Main Window')
    tab = ElementTree.SubElement(windows, 'Tab', tab_name='drive', containers='1')
    container = ElementTree.SubElement(tab, 'Container')
    splitter = ElementTree.SubElement(
        container, 'DockSplitter', orientation='-', count=str(len(PLOTS)),
        sizes=';'.join([f'{1 / len(PLOTS):.4f}'] * len(PLOTS)))
    for plot in PLOTS:
        area = ElementTree.SubElement(splitter, 'DockArea', name=plot.title)
        shown = ElementTree.SubElement(
            area, 'plot', mode='TimeSeries', style='Lines', flip_x='false', flip_y='false')
        for name, colour in zip(plot.values, COLOURS):
            ElementTree.SubElement(shown, 'curve', color=colour,
                                   name=f'{full(STEP.name)}/{name}/position')
    ElementTree.SubElement(windows, 'currentTabIndex', index='0')
    ElementTree.SubElement(root, 'use_relative_time_offset', enabled='1')
    ElementTree.indent(root)
    return f"<?xml version='1.0' encoding='UTF-8'?>\n{ElementTree.tostring(root, 'unicode')}\n"


LAYOUTS = {'foxglove.json': foxglove, 'plotjuggler.xml': plotjuggler}


def plotted() -> Iterator[str]:
    """Yield the values of `step` that stand in a layout."""
    yield 'episode'
    for plot in PLOTS:
        yield from plot.values


if __name__ == '__main__':
    for name, make in LAYOUTS.items():
        write_text(Path(sys.argv[1]) / name, make())
