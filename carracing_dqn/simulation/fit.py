# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Whether what a simulator or a robot was seen to do fits a profile and a model."""
from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
import dataclasses
import statistics
from typing import Any, NamedTuple

import numpy as np

from carracing_dqn.simulation.picture_motion import turned_left
from msgs_bridge import topics
from msgs_bridge.images import ENCODINGS
from msgs_bridge.picture_parts import Crop, parse_crop
from msgs_bridge.stamps import NANOSECONDS

GOOD, UNSURE, BAD = 'fits', 'unsure', 'does not fit'

IMAGE_TYPE, COMPRESSED_TYPE = topics.IMAGE.type_name, topics.COMPRESSED_TYPE
STAMPED_TYPE, PLAIN_TYPE = topics.CMD_VEL.type_name, topics.PLAIN_TWIST_TYPE
# rates within this share of each other are one
RATE_TOLERANCE = 0.15
# of the gaps between images may be half as long again as the usual one
LATE_SHARE = 0.05
# mean colours nearer than this are the same, of 255
COLOUR_TOLERANCE = 12.0
# stamps above this are wall-clock time; ns
WALL_CLOCK = 10 ** 9 * NANOSECONDS


class Finding(NamedTuple):
    """One thing that was looked at: its name, a verdict, what was found, what mends it."""

    name: str
    verdict: str
    found: str
    mend: str = ''


@dataclasses.dataclass
class Seen:
    """
    What was seen of a car for some seconds.

    Attributes:
        image_topic, cmd_vel_topic, step_topic: full names.
        image_types: types that are published on the image topic.
        other_images: topics with images that others publish.
        arrivals: wall time of each image in s.
        stamps: of each image in ns.
        encodings, sizes: those that came, (width, height).
        refused: why images could not be used, each reason once.
        frames: series of the size that the model sees, each with what the car was told
            meanwhile: '', 'left' or 'right'.
        offered: reliability of the publishers of images.
        twist_types: types that are subscribed to on the topic of the twists.
        deaf: why a subscription of it hears nothing from the policy, each a text.
        drivers: other nodes that publish twists.
        steps: whether anybody publishes `step`.
    """

    image_topic: str
    cmd_vel_topic: str
    image_types: Sequence[str] = ()
    other_images: Sequence[str] = ()
    arrivals: list[float] = dataclasses.field(default_factory=list)
    stamps: list[int] = dataclasses.field(default_factory=list)
    encodings: set[str] = dataclasses.field(default_factory=set)
    sizes: set[tuple[int, int]] = dataclasses.field(default_factory=set)
    refused: set[str] = dataclasses.field(default_factory=set)
    frames: list[tuple[str, list[np.ndarray]]] = dataclasses.field(default_factory=list)
    offered: Sequence[str] = ()
    twist_types: Sequence[str] = ()
    deaf: Sequence[str] = ()
    drivers: Sequence[str] = ()
    steps: bool = False

    def told(self, what: str) -> list[list[np.ndarray]]:
        """Return the series of frames that came while the car was told one thing."""
        return [series for told, series in self.frames if told == what and series]


@dataclasses.dataclass(frozen=True)
class Wanted:
    """
    What a profile and a model ask for.

    Attributes:
        vehicle: parameters of the policy.
        camera: `width`, `height`, `encoding`, `rate` in Hz and `mean_rgb` of the images.
        frame: (width, height) that the model sees.
        decision_seconds: how long the model holds an action.
    """

    vehicle: Mapping[str, Any]
    camera: Mapping[str, Any]
    frame: tuple[int, int]
    decision_seconds: float


def findings(seen: Seen, wanted: Wanted) -> Iterator[Finding]:
    """Yield what was found of everything that can be said."""
    yield _images(seen, wanted)
    if seen.arrivals:
        yield _rate(seen, wanted)
        yield _stamps(seen)
        yield _size(seen, wanted)
        yield _encoding(seen, wanted)
        if any(series for _, series in seen.frames):
            yield _colours(seen, wanted)
    yield from _twists(seen, wanted)
    if seen.arrivals:
        yield _steering(seen, wanted)
    yield Finding('step', GOOD if seen.steps else UNSURE, 'is published: it can be learned from'
                  if seen.steps else 'nobody publishes it: it can be driven, not learned from',
                  '' if seen.steps else 'a referee makes it of topics that a robot has')


def _images(seen: Seen, wanted: Wanted) -> Finding:
    compressed = bool(wanted.vehicle.get('camera_compressed', False))
    right, other = ((COMPRESSED_TYPE, IMAGE_TYPE) if compressed else (IMAGE_TYPE, COMPRESSED_TYPE))
    if not seen.image_types:
        there = ', '.join(seen.other_images)
        return Finding('images', BAD, f'nobody publishes {seen.image_topic}',
                       f'-r image_raw:={seen.other_images[0]} (there are {there})' if there
                       else 'is it running, in this ROS_DOMAIN_ID and namespace?')
    if right not in seen.image_types:
        mend = (f'camera_compressed:={str(not compressed).lower()}'
                if other in seen.image_types else '-r image_raw:=TOPIC names another topic')
        return Finding('images', BAD, f'{seen.image_topic} is {seen.image_types[0]}', mend)
    if not seen.arrivals:
        return Finding('images', BAD, f'none came on {seen.image_topic}',
                       'a simulator in lockstep waits for a driver (--nudge), a paused one for '
                       '~/pause false')
    if seen.refused:
        return Finding('images', BAD, f'refused: {sorted(seen.refused)[0]}',
                       'camera_encoding, camera_crop or camera_compressed')
    return Finding('images', GOOD, f'{len(seen.arrivals)} on {seen.image_topic}, '
                   f'{" and ".join(sorted(set(seen.offered)))}')


def _rate(seen: Seen, wanted: Wanted) -> Finding:
    """Return what is to be said of the rate, by stamps where those go on."""
    times = [stamp / NANOSECONDS for stamp in seen.stamps]
    if not _rising(seen.stamps):
        times = seen.arrivals
    gaps = [after - before for before, after in zip(times, times[1:])]
    if not gaps or statistics.median(gaps) <= 0:
        return Finding('rate', UNSURE, 'too few images came to tell')
    period = statistics.median(gaps)
    late = sum(gap > 1.5 * period for gap in gaps)
    text = (f'{1 / period:.1f} Hz by {"arrival" if times is seen.arrivals else "stamp"}, '
            f'{late} of {len(gaps)} gaps too long')
    told = wanted.camera.get('rate')
    if told and abs(1 / period / told - 1) > RATE_TOLERANCE:
        return Finding('rate', BAD, f'{text}; the profile says {told:g} Hz',
                       'the rate of the camera, or camera.rate of the profile')
    if period > wanted.decision_seconds * (1 + RATE_TOLERANCE):
        return Finding('rate', BAD,
                       f'{text}; the model decides every {wanted.decision_seconds:g} s',
                       'a faster camera, or a model that learned from this one')
    if late > LATE_SHARE * len(gaps):
        return Finding('rate', UNSURE, text, 'a camera, network or machine that keeps up')
    return Finding('rate', GOOD, text)


def _stamps(seen: Seen) -> Finding:
    if not any(seen.stamps):
        return Finding('stamps', UNSURE, 'all are zero: the time of arrival counts',
                       'a camera that stamps its images, if steps are to be joined with them')
    if len(seen.stamps) == 1:
        return Finding('stamps', UNSURE, 'too few images came to tell')
    if len(set(seen.stamps)) == 1:
        return Finding('stamps', UNSURE, 'all are equal: the time of arrival counts',
                       'a camera that stamps its images, if steps are to be joined with them')
    if not _rising(seen.stamps):
        return Finding('stamps', BAD, 'they go back or stay equal now and then',
                       'one publisher on the topic, and one clock')
    kind = 'wall clock' if seen.stamps[0] > WALL_CLOCK else 'simulation time'
    return Finding('stamps', GOOD, f'rising, {kind}')


def _size(seen: Seen, wanted: Wanted) -> Finding:
    sizes = ' and '.join(f'{width}x{height}' for width, height in sorted(seen.sizes))
    seen_as = f'the model sees {wanted.frame[0]}x{wanted.frame[1]}'
    if not seen.sizes:
        return Finding('size', BAD, 'of no image that can be used', 'camera_compressed')
    width, height = min(seen.sizes)
    told = wanted.camera.get('width', width), wanted.camera.get('height', height)
    if seen.sizes != {told}:
        return Finding('size', BAD, f'{sizes}; the profile says {told[0]}x{told[1]}',
                       'the size of the camera, or camera.width and height of the profile')
    crop = parse_crop('camera_crop', wanted.vehicle.get('camera_crop', ''))
    if crop and not any(series for _, series in seen.frames):
        text = ','.join(map(str, crop))
        return Finding('size', BAD, f'{sizes}, on which camera_crop {text} does not fit',
                       "camera_crop:='LEFT,TOP,WIDTH,HEIGHT'")
    part = crop or Crop(0, 0, width, height)
    across, down = wanted.frame
    if wanted.vehicle.get('camera_turn', '0') in ('90', '270'):
        # it is cropped before it is turned
        across, down = down, across
    if abs(part.width * down / (part.height * across) - 1) > 0.02:
        side = min(part.width / across, part.height / down)
        keep = round(side * across), round(side * down)
        left, top = part.left + (part.width - keep[0]) // 2, part.top + part.height - keep[1]
        return Finding(
            'size', BAD, f'{sizes} is squeezed into {wanted.frame[0]}x{wanted.frame[1]}',
            f"camera_crop:='{left},{top},{keep[0]},{keep[1]}', or another part of these "
            'proportions')
    return Finding('size', GOOD, f'{sizes}, {seen_as}')


def _encoding(seen: Seen, wanted: Wanted) -> Finding:
    found = ' and '.join(sorted(seen.encodings)) or 'none'
    told, forced = wanted.camera.get('encoding'), wanted.vehicle.get('camera_encoding', '')
    if told and seen.encodings != {told}:
        return Finding('encoding', BAD, f'{found}; the profile says {told}',
                       'camera.encoding of the profile; camera_encoding if the camera says it '
                       'wrongly')
    if forced and seen.encodings != {forced}:
        return Finding('encoding', UNSURE, f'{found}, read as {forced}',
                       'camera_encoding, if the camera says it rightly')
    return Finding('encoding', GOOD, found)


def _colours(seen: Seen, wanted: Wanted) -> Finding:
    frames = [frame for _, series in seen.frames for frame in series]
    mean = np.mean([frame.reshape(-1, 3).mean(0) for frame in frames], axis=0)
    found = f'mean red, green, blue {", ".join(f"{value:.0f}" for value in mean)}'
    if np.ptp(np.concatenate([frame.reshape(-1) for frame in frames])) == 0:
        return Finding('colours', BAD, f'{found}: one colour everywhere', 'a camera that sees')
    told = wanted.camera.get('mean_rgb')
    if not told:
        return Finding('colours', UNSURE, found,
                       'camera.mean_rgb of the profile, where the camera is known to be right')
    apart = np.abs(mean - told).max()
    if apart <= COLOUR_TOLERANCE:
        return Finding('colours', GOOD, found)
    said = f'{found}; the profile says {", ".join(f"{value:g}" for value in told)}'
    if np.abs(mean[::-1] - told).max() < min(apart, COLOUR_TOLERANCE):
        return Finding('colours', BAD, f'{said}: red and blue are exchanged',
                       f'camera_encoding:={_exchanged(_read_as(seen, wanted))}')
    return Finding('colours', BAD, said, 'exposure or place of the camera, or camera.mean_rgb')


def _read_as(seen: Seen, wanted: Wanted) -> str:
    """Return the encoding by which the images are read now."""
    said = () if wanted.vehicle.get('camera_compressed') else seen.encodings
    return wanted.vehicle.get('camera_encoding') or min(ENCODINGS.keys() & said, default='rgb8')


def _exchanged(encoding: str) -> str:
    """Return the encoding of as many channels with red in the place of blue."""
    channels, (red, green, blue) = ENCODINGS[encoding]
    return next(name for name, one in ENCODINGS.items() if one == (channels, (blue, green, red)))


def _twists(seen: Seen, wanted: Wanted) -> Iterator[Finding]:
    stamped = bool(wanted.vehicle.get('cmd_vel_stamped', True))
    right, other = ((STAMPED_TYPE, PLAIN_TYPE) if stamped else (PLAIN_TYPE, STAMPED_TYPE))
    if not seen.twist_types:
        yield Finding('twists', BAD, f'nobody hears {seen.cmd_vel_topic}',
                      '-r cmd_vel:=TOPIC names the topic that the car listens to')
    elif right not in seen.twist_types:
        yield Finding('twists', BAD, f'{seen.cmd_vel_topic} is heard as {seen.twist_types[0]}',
                      f'cmd_vel_stamped:={str(not stamped).lower()}'
                      if other in seen.twist_types else '-r cmd_vel:=TOPIC names another topic')
    elif seen.deaf:
        yield Finding('twists', BAD, seen.deaf[0], 'the QoS of that subscription')
    else:
        yield Finding('twists', GOOD, f'{seen.cmd_vel_topic} is heard as {right}')
    if seen.drivers:
        yield Finding('driver', UNSURE, f'{", ".join(seen.drivers)} drives already',
                      'stop it before the policy drives')


def _steering(seen: Seen, wanted: Wanted) -> Finding:
    left, right = seen.told('left'), seen.told('right')
    if not left or not right:
        return Finding('steering', UNSURE, 'not tried' if not seen.drivers else
                       'not tried, another node drives', '--nudge turns it left and right')
    turned = turned_left(left, right)
    if turned is None:
        return Finding('steering', UNSURE, 'the picture does not turn with what the car is told',
                       'look at it: does it turn left at angular.z above 0?')
    if turned:
        return Finding('steering', GOOD, 'told left, the picture turned as it should')
    scale = float(wanted.vehicle.get('angular_scale', 1.0))
    return Finding('steering', BAD, 'told left, it turned right',
                   f'angular_scale:={-scale:g}, or camera_mirror if the picture is a mirror image')


def _rising(stamps: Sequence[int]) -> bool:
    return len(stamps) > 1 and all(
        before < after for before, after in zip(stamps, stamps[1:]))
