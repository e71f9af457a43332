# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A lap seen from above: where the car was fast, where it earned, where it left the road."""
from __future__ import annotations

from pathlib import Path

from carracing_dqn.evaluation import figure_style as style
from carracing_dqn.evaluation.laps import Lap, picture_name, Policy
from carracing_dqn.evaluation.statistics import STOPPED_FRAMES
from carracing_dqn.evaluation.trajectory import drive_trajectory, Trajectory
from carracing_dqn.simulation import make_simulator
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colorbar import Colorbar
from matplotlib.colors import Colormap, LinearSegmentedColormap, Normalize, TwoSlopeNorm
from matplotlib.figure import Figure
from msgs_bridge.atomic_write import write_bytes
from msgs_bridge.simulator import Simulator
import numpy as np

WIDTH, PHONE_WIDTH = 9.6, 4.6
FRAMES_PER_SECOND = 50
ROAD = '#dcdcdc'
MISSED = '#f5b8d8'
COSTS = -5.0
"""Reward in points a second when no tile is new: 50 frames at -0.1."""
FULL_SPEED = 100.0
"""Speed in m/s that the scale reaches at least, so that laps can be compared by colour."""

# losing in one hue and earning in another, none of them as pale as the road
_LOSS_AND_GAIN = LinearSegmentedColormap.from_list('loss and gain', (
    (0.0, '#b34700'), (0.4999, '#f2a36b'), (0.5, '#a6cbe8'), (1.0, '#08306b')))
# inches beside the maps: colour bar, titles, legend
_BESIDE, _ABOVE, _BELOW = 0.75, 0.75, 0.45


def lap_picture(trajectory: Trajectory, *, phone: bool = False) -> Figure:
    """
    Return the picture of a lap: two maps side by side, or one above the other for a phone.

    Args:
        trajectory: see `trajectory.drive_trajectory`.
        phone: narrow and high.
    """
    stacked = phone
    with style.styled():
        figure = style.new_figure(_size(trajectory, stacked))
        figure.suptitle(lap_title(trajectory.lap), fontsize=10.5 if stacked else 12,
                        fontweight='bold', wrap=True)
        speed_axes, reward_axes = figure.subplots(*((2, 1) if stacked else (1, 2)))
        scale = Normalize(0.0, max(FULL_SPEED, float(trajectory.speed.max())))
        _map(figure, speed_axes, trajectory, trajectory.speed, 'Speed', 'm/s', 'viridis', scale)
        rate = trajectory.reward_rate
        limits = TwoSlopeNorm(vmin=COSTS, vcenter=0.0, vmax=max(1.0, float(rate.max())))
        bar = _map(figure, reward_axes, trajectory, rate, 'Reward', 'points/s', _LOSS_AND_GAIN,
                   limits)
        bar.set_label('losses and gains each on a scale of their own', fontsize='small')
        bar.set_ticks([COSTS, *np.arange(0.0, limits.vmax, 20.0)])
        handles, labels = speed_axes.get_legend_handles_labels()
        figure.legend(handles, labels, loc='outside lower center', ncols=2 if stacked else 5)
    return figure


def lap_title(lap: Lap) -> str:
    """Return what came of a lap, in one line."""
    return (f'Track {lap.seed}: return {lap.episode_return:.1f}, {lap_end(lap)} '
            f'({lap.tiles_visited} of {lap.tiles_total} tiles)')


def lap_end(lap: Lap) -> str:
    """Return how a lap ended, in words."""
    seconds = f'{lap.frames / FRAMES_PER_SECOND:.1f} s'
    if lap.lap_finished:
        return f'lap finished in {seconds}'
    if lap.left_field:
        return f'left the field after {seconds}'
    if lap.standing_still > STOPPED_FRAMES:
        return f'stood still for the last {lap.standing_still / FRAMES_PER_SECOND:.1f} s'
    return f'not finished in {seconds}'


def draw_lap(
    policy: Policy, seed: int, path: Path | str, *, simulator: str = 'fast',
) -> Lap:
    """
    Drive the track of a seed in this process and write its picture as PNG.

    Raises:
        PolicyError: an action that is not three finite numbers in range.
        OSError: the file cannot be written.
    """
    made = make_simulator(simulator)
    try:
        trajectory = drive_trajectory(made, policy, seed)
    finally:
        made.close()
    write_bytes(path, style.image_bytes(lap_picture(trajectory), 'png'))
    return trajectory.lap


def drive_and_draw(
    simulator: Simulator, policy: Policy, seed: int, *, folder: Path | str,
) -> Lap:
    """Drive a lap in a simulator and write `lap_SEED.png` into a folder; raises OSError."""
    trajectory = drive_trajectory(simulator, policy, seed)
    write_bytes(Path(folder) / picture_name(seed),
                style.image_bytes(lap_picture(trajectory), 'png'))
    return trajectory.lap


def _map(
    figure: Figure, axes: Axes, trajectory: Trajectory, values: np.ndarray, title: str,
    unit: str, colours: str | Colormap, norm: Normalize,
) -> Colorbar:
    """Draw the track and the way of the car, coloured by one value a frame."""
    left, right = trajectory.left_edge, trajectory.right_edge
    tiles = np.stack((left, right, np.roll(right, 1, axis=0), np.roll(left, 1, axis=0)), axis=1)
    axes.add_collection(PolyCollection(
        tiles, facecolors=np.where(trajectory.visited, ROAD, MISSED), edgecolors='none'))
    way = trajectory.position
    line = LineCollection(
        np.stack((way[:-1], way[1:]), axis=1), array=values[1:], cmap=colours, norm=norm,
        linewidths=2.6, capstyle='round')
    axes.add_collection(line)
    _marks(axes, trajectory)
    axes.set_title(f'{title}, {unit}')
    axes.set_aspect('equal')
    axes.autoscale_view()
    axes.margins(0.04)
    axes.grid(visible=False)
    axes.set_xticks(())
    axes.set_yticks(())
    for spine in axes.spines.values():
        spine.set_visible(False)
    _scale_bar(axes)
    bar = figure.colorbar(line, ax=axes, shrink=0.8, pad=0.02, aspect=24)
    bar.outline.set_visible(False)
    return bar


def _size(trajectory: Trajectory, stacked: bool) -> tuple[float, float]:
    """Return width and height in inches that fit the shape of the track."""
    points = np.concatenate((trajectory.left_edge, trajectory.right_edge, trajectory.position))
    across, along = np.ptp(points, axis=0)
    width = PHONE_WIDTH if stacked else WIDTH
    map_width = (width if stacked else width / 2) - _BESIDE
    map_height = min(1.4 * map_width, max(2.0, map_width * along / across))
    maps = 2 if stacked else 1
    return width, maps * (map_height + 0.35) + _ABOVE + _BELOW


def _marks(axes: Axes, trajectory: Trajectory) -> None:
    """Mark start and end, departures from the road, tiles not visited and where it stopped."""
    way = trajectory.position
    edge = {'markeredgecolor': 'white', 'linestyle': 'none', 'zorder': 5}
    axes.plot(*way[0], marker='^', markersize=9, color=style.INK, label='start', **edge)
    axes.plot(*way[-1], marker='o', markersize=8, color=style.INK, label='end', **edge)
    stretches = trajectory.off_road
    if stretches:
        points = way[[first for first, _ in stretches]]
        axes.plot(*points.T, marker='X', markersize=9, color=style.VERMILION,
                  label='left the road', **edge)
    if trajectory.lap.standing_still > STOPPED_FRAMES:
        axes.plot(*way[-trajectory.lap.standing_still], marker='s', markersize=10,
                  color=style.BLUE, label='stopped', **edge)
    if not trajectory.visited.all():
        axes.plot([], [], marker='s', markersize=9, color=MISSED, linestyle='none',
                  label='tile not visited')


def _scale_bar(axes: Axes, length: float = 50.0) -> None:
    """Draw a length at the lower left, because the axes have no numbers."""
    low_x, low_y = axes.get_xlim()[0], axes.get_ylim()[0]
    axes.plot((low_x, low_x + length), (low_y, low_y), color=style.GREY, linewidth=2)
    axes.annotate(f'{length:.0f} m', (low_x, low_y), xytext=(0, 3),
                  textcoords='offset points', fontsize=8.5, color=style.GREY)
