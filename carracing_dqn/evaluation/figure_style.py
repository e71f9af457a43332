# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""One look for every figure: fonts, colours that colour-blind readers can tell apart, saving."""
from __future__ import annotations

from collections.abc import Iterator
import contextlib
import io
from pathlib import Path
import warnings

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from msgs_bridge.atomic_write import write_bytes
from msgs_bridge.plain_text import plain

# M. Okabe and K. Ito, Color Universal Design, 2008
BLUE = '#0072b2'
VERMILION = '#d55e00'
GREEN = '#009e73'
PURPLE = '#cc79a7'
ORANGE = '#e69f00'
SKY = '#56b4e9'
INK = '#222222'
GREY = '#767676'
PALE = '#d9d9d9'

RUN_COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, INK, GREY)
RUN_DASHES = ('-', '--', '-.', ':', (0, (5, 1)), (0, (1, 1)), (0, (3, 1, 1, 1)), (0, (5, 4)))
"""Runs differ in their dashes too, for those who see no colours at all."""

DUMMY_COLOUR = ORANGE
SEED_COLOUR = GREY
RESOLUTION = 144
"""Dots per inch of the PNG files."""

WIDE, NARROW = (7.6, 4.2), (4.4, 3.6)
"""Width and height in inches of a figure, on a page and on a phone."""

STYLE = {
    'font.size': 10.5,
    'font.family': 'DejaVu Sans',
    'axes.titlesize': 11.5,
    'axes.titleweight': 'bold',
    'axes.titlelocation': 'left',
    'axes.edgecolor': GREY,
    'axes.labelcolor': INK,
    'axes.spines.top': False,
    'axes.spines.right': False,
    'axes.grid': True,
    'axes.axisbelow': True,
    'grid.color': '#e8e8e8',
    'grid.linewidth': 0.8,
    'text.color': INK,
    'xtick.color': INK,
    'ytick.color': INK,
    'xtick.labelsize': 9.5,
    'ytick.labelsize': 9.5,
    'legend.frameon': False,
    'legend.fontsize': 9.5,
    'lines.linewidth': 1.8,
    'savefig.facecolor': 'white',
    # the same data give the same file
    'svg.hashsalt': 'carracing_dqn',
    'svg.fonttype': 'path',
}


@contextlib.contextmanager
def styled() -> Iterator[None]:
    """Draw with our style inside the block, whatever the user's matplotlibrc says."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(STYLE)
        yield


def new_figure(size: tuple[float, float] = WIDE) -> Figure:
    """Return an empty figure of a width and height in inches."""
    return Figure(figsize=size, layout='constrained')


def label(name: str) -> str:
    """Return the name of a run as figures take it: no formula, and never left out of a legend."""
    text = plain(name).replace('$', r'\$')
    # matplotlib keeps names that begin with an underscore to itself
    return f' {text}' if text.startswith('_') else text


def image_bytes(figure: Figure, kind: str) -> bytes:
    """Return a figure as 'png' or 'svg'."""
    data = io.BytesIO()
    with styled(), warnings.catch_warnings():
        # names of runs may be of any script; what the font lacks is drawn as a box
        warnings.filterwarnings('ignore', r'Glyph \d+ .* missing from font')
        figure.savefig(
            data, format=kind, dpi=RESOLUTION,
            metadata={'Date': None} if kind == 'svg' else {'Software': None})
    return data.getvalue()


def save_figure(figure: Figure, folder: Path, name: str) -> list[Path]:
    """Write a figure as PNG and SVG; return the paths; raises OSError."""
    paths = []
    for kind in ('png', 'svg'):
        paths.append(folder / f'{name}.{kind}')
        write_bytes(paths[-1], image_bytes(figure, kind))
    return paths


def horizontal_mark(axes: Axes, value: float, text: str) -> None:
    """Draw a thin line across at a value, with its name below the right end."""
    axes.axhline(value, color=SEED_COLOUR, linewidth=1.0, linestyle=(0, (4, 3)), zorder=1)
    axes.annotate(
        text, (1.0, value), xycoords=('axes fraction', 'data'), xytext=(0, -2),
        textcoords='offset points', ha='right', va='top', fontsize=8.5, color=SEED_COLOUR)
