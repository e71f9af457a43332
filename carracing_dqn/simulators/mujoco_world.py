# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
A car of 3 kg and a closed track of a seed as MJCF, the text that MuJoCo compiles.

Metres, seconds, radians; x, y, z as in REP-103, the ground is z = 0. What the car touches is the
ground, kerbs inside of the bends and walls outside of them; road and lines are only seen.
"""
from __future__ import annotations

import dataclasses
import math

import numpy as np

HALF_WIDTH = 0.55
# from the centre line; who is farther away has left the field
FIELD = 3.0
TILE_LENGTH = 0.3
MEAN_RADIUS = 9.0
# of the centre line in the sharpest bend
SMALLEST_RADIUS = 1.2
# between two parts of the centre line that do not follow each other
SMALLEST_GAP = 2.6
# bends of a smaller radius have kerbs and walls
BEND_RADIUS = 3.0
KERB, KERB_HEIGHT = 0.07, 0.008
WALL_DISTANCE, WALL_HEIGHT = HALF_WIDTH + 0.5, 0.12
# waves of the radius around the circle, and how high the highest of them may be
HARMONICS = np.arange(2, 9)
LOWEST_WAVE, HIGHEST_WAVE = 0.18, 0.6
TRIES = 10_000

WHEELBASE, TREAD = 0.30, 0.24
WHEEL_RADIUS, WHEEL_HALF_WIDTH = 0.055, 0.022
STEERING_LIMIT = 0.38
# at each rear wheel, N m; resistance of a wheel, N m s
TORQUE = 0.33
ROAD_RESISTANCE, GRASS_RESISTANCE = 0.0015, 0.012
STEP_SECONDS = 0.005
WHEELS = ('front_left', 'front_right', 'rear_left', 'rear_right')
WALL_PREFIX = 'wall'


@dataclasses.dataclass(frozen=True)
class Track:
    """
    A closed centre line in pieces of equal length, driven in the order of its points.

    Attributes:
        points: (N, 2), m.
        headings: (N,) of the line at each point, rad.
        curvature: (N,) 1/m, positive to the left.
        spacing: between two points, m.
    """

    points: np.ndarray
    headings: np.ndarray
    curvature: np.ndarray
    spacing: float

    def __len__(self) -> int:
        return len(self.points)

    def nearest(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the nearest point of the line to each place, and how far left of it, m."""
        away = places[:, None] - self.points[None]
        indices = np.einsum('pnk,pnk->pn', away, away).argmin(1)
        left = away[np.arange(len(places)), indices]
        headings = self.headings[indices]
        return indices, left[:, 1] * np.cos(headings) - left[:, 0] * np.sin(headings)

    def side(self, left: float) -> np.ndarray:
        """Return the line that runs so far to the left of the centre, (N, 2)."""
        normals = np.stack([-np.sin(self.headings), np.cos(self.headings)], 1)
        return self.points + left * normals


def make_track(random: np.random.Generator) -> Track:
    """Draw a track: a circle with some waves, without a bend that is too sharp."""
    for _ in range(TRIES):
        sizes = random.uniform(LOWEST_WAVE, HIGHEST_WAVE, len(HARMONICS)) / HARMONICS
        phases = random.uniform(0.0, 2 * math.pi, len(HARMONICS))
        backwards = random.random() < 0.5
        angles = np.linspace(0.0, 2 * math.pi, 2000, endpoint=False)
        radii = MEAN_RADIUS * (1 + np.cos(np.outer(angles, HARMONICS) + phases) @ sizes)
        line = np.stack([radii * np.cos(angles), radii * np.sin(angles)], 1)
        track = _in_pieces(line[::-1] if backwards else line)
        if _is_good(track):
            return track
    raise AssertionError('no track within so many tries')


def _in_pieces(line: np.ndarray) -> Track:
    closed = np.vstack([line, line[:1]])
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(closed, axis=0).T))])
    count = round(along[-1] / TILE_LENGTH)
    at = np.linspace(0.0, along[-1], count, endpoint=False)
    points = np.stack([np.interp(at, along, closed[:, axis]) for axis in (0, 1)], 1)
    ahead = np.roll(points, -1, 0) - np.roll(points, 1, 0)
    headings = np.arctan2(ahead[:, 1], ahead[:, 0])
    spacing = along[-1] / count
    turned = np.angle(np.exp(1j * (np.roll(headings, -1) - np.roll(headings, 1))))
    return Track(points, headings, turned / (2 * spacing), spacing)


def _is_good(track: Track) -> bool:
    if np.abs(track.curvature).max() > 1 / SMALLEST_RADIUS:
        return False
    count = len(track)
    apart = np.hypot(*(track.points[:, None] - track.points[None]).transpose(2, 0, 1))
    steps = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    along = np.minimum(steps, count - steps) * track.spacing
    return bool((apart[along > math.pi / 2 * SMALLEST_GAP] > SMALLEST_GAP).all())


def steering_angles(angular: float) -> tuple[float, float]:
    """Return the angles of the front wheels, left and right, at a command within [-1, 1]."""
    angle = angular * STEERING_LIMIT
    if angle == 0.0:
        return 0.0, 0.0
    # both turn about one point on the line of the rear axle
    middle = WHEELBASE / math.tan(angle)
    return (math.atan(WHEELBASE / (middle - TREAD / 2)),
            math.atan(WHEELBASE / (middle + TREAD / 2)))


def world_xml(track: Track, side: int) -> str:
    """
    Return the MJCF of a car at the start of a track.

    Args:
        track: where it stands.
        side: of the largest picture that is drawn, pixels.
    """
    x, y = track.points[0]
    heading = float(track.headings[0])
    reach = float(np.abs(track.points).max()) + 2 * FIELD
    return f"""
<mujoco model="car">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="{STEP_SECONDS}" integrator="implicitfast" cone="elliptic" impratio="10"/>
  <statistic center="0 0 0" extent="{reach:.3f}"/>
  <visual>
    <global offwidth="{side}" offheight="{side}" fovy="45"/>
    <quality offsamples="4" shadowsize="0" numslices="12" numstacks="6" numquads="1"/>
    <map znear="0.002" zfar="4"/>
    <headlight ambient="0.75 0.75 0.75" diffuse="0.25 0.25 0.25" specular="0 0 0"/>
    <rgba haze="0.6 0.75 0.9 1"/>
  </visual>
  <asset>
    <texture name="sky" type="skybox" builtin="gradient" rgb1="0.5 0.7 0.95" rgb2="0.8 0.9 1"
             width="64" height="64"/>
    <texture name="grass" type="2d" builtin="checker" rgb1="0.36 0.70 0.30" rgb2="0.42 0.78 0.36"
             width="64" height="64"/>
    <material name="grass" texture="grass" texrepeat="1 1" texuniform="true"/>
    {_strip_mesh('road', track, HALF_WIDTH, 0.004)}
    {_strip_mesh('line', track, HALF_WIDTH + 0.05, 0.002)}
  </asset>
  <default>
    <geom contype="1" conaffinity="2" friction="1.0 0.005 0.0001"/>
    <default class="seen"><geom contype="0" conaffinity="0"/></default>
    <default class="car">
      <geom contype="2" conaffinity="1"/>
      <default class="wheel">
        <geom type="cylinder" size="{WHEEL_RADIUS} {WHEEL_HALF_WIDTH}" mass="0.15"
              quat="0.7071068 0.7071068 0 0" rgba="0.08 0.08 0.08 1" condim="4"/>
        <joint axis="0 1 0" damping="{ROAD_RESISTANCE}" armature="0.0002"/>
      </default>
      <default class="knuckle">
        <joint axis="0 0 1" range="-0.6 0.6" damping="0.25" armature="0.002"/>
      </default>
    </default>
  </default>
  <worldbody>
    <geom name="ground" type="plane" size="{reach:.3f} {reach:.3f} 1" material="grass"/>
    <geom class="seen" type="mesh" mesh="line" rgba="0.95 0.95 0.95 1"/>
    <geom class="seen" type="mesh" mesh="road" rgba="0.40 0.40 0.41 1"/>
    {''.join(_bounds(track))}
    <body name="car" childclass="car" pos="{x:.6f} {y:.6f} {WHEEL_RADIUS}"
          euler="0 0 {heading:.6f}">
      <freejoint name="car"/>
      <camera name="bonnet" pos="0.05 0 0.28" xyaxes="0 -1 0 0.42 0 0.91" fovy="75"/>
      <geom name="hull" type="box" size="0.20 0.075 0.03" pos="0 0 0.025" mass="2.4"
            rgba="0.85 0.10 0.10 1"/>
      <geom name="cabin" type="box" size="0.06 0.06 0.02" pos="-0.05 0 0.075" mass="0.05"
            rgba="0.95 0.85 0.20 1"/>
      {''.join(map(_wheel, WHEELS))}
    </body>
  </worldbody>
  <actuator>
    <position name="steer_left" joint="front_left_steer" kp="6" forcerange="-3 3"/>
    <position name="steer_right" joint="front_right_steer" kp="6" forcerange="-3 3"/>
    <motor name="drive_left" joint="rear_left" gear="{TORQUE}"/>
    <motor name="drive_right" joint="rear_right" gear="{TORQUE}"/>
  </actuator>
</mujoco>
"""


def _wheel(name: str) -> str:
    end, hand = name.split('_')
    x = WHEELBASE / 2 if end == 'front' else -WHEELBASE / 2
    y = TREAD / 2 if hand == 'left' else -TREAD / 2
    wheel = f'<joint name="{name}" class="wheel"/><geom name="{name}" class="wheel"/>'
    if end == 'rear':
        return f'<body name="{name}" pos="{x} {y} 0">{wheel}</body>'
    return (f'<body name="{name}_knuckle" pos="{x} {y} 0">'
            f'<joint name="{name}_steer" class="knuckle"/>'
            '<inertial pos="0 0 0" mass="0.05" diaginertia="0.0001 0.0001 0.0001"/>'
            f'<body name="{name}">{wheel}</body></body>')


def _strip_mesh(name: str, track: Track, half_width: float, height: float) -> str:
    """Return the mesh of a strip along the centre line, seen from above."""
    count = len(track)
    corners = np.empty((2 * count, 3))
    corners[0::2, :2], corners[1::2, :2] = track.side(half_width), track.side(-half_width)
    corners[:, 2] = height
    left = np.arange(count) * 2
    after = (left + 2) % (2 * count)
    faces = np.concatenate([np.stack([left, left + 1, after + 1], 1),
                            np.stack([left, after + 1, after], 1)])
    return (f'<mesh name="{name}" inertia="shell" vertex="{_numbers(corners, ".4f")}" '
            f'face="{_numbers(faces, "d")}"/>')


def _numbers(array: np.ndarray, form: str) -> str:
    return ' '.join(format(one, form) for one in array.ravel().tolist())


def _bounds(track: Track) -> list[str]:
    """Return kerbs inside and walls outside of the bends."""
    found = []
    for number, curvature in enumerate(track.curvature):
        if abs(curvature) < 1 / BEND_RADIUS:
            continue
        inside = 1.0 if curvature > 0 else -1.0
        for name, away, half_thick, height in (
                ('kerb', inside * (HALF_WIDTH + KERB), KERB, KERB_HEIGHT),
                (WALL_PREFIX, -inside * WALL_DISTANCE, 0.04, WALL_HEIGHT)):
            x, y = track.side(away)[number]
            # the outer line is longer than the centre line, and pieces are to meet
            length = track.spacing * (1 - away * curvature)
            colour = '0.85 0.12 0.12 1' if number % 2 else '0.95 0.95 0.95 1'
            found.append(
                f'<geom name="{name}{number}" type="box" pos="{x:.4f} {y:.4f} {height / 2:.4f}" '
                f'size="{length / 2:.4f} {half_thick} {height / 2:.4f}" '
                f'euler="0 0 {track.headings[number]:.4f}" rgba="{colour}"/>')
    # walls after kerbs, so that their numbers follow each other
    return sorted(found, key=lambda geom: WALL_PREFIX in geom)
