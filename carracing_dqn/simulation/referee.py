# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
What a robot does not say itself: what a frame earned and where an episode ends. Without ROS.

Every image is judged once, in order, by what was heard up to it: odometry as new as the image,
the flags and numbers that came with it, the twist that was applied since the image before. While
something that a term needs is missing no step is made up: the frame is left out, and `missing`
says why.
"""
from __future__ import annotations

from collections import Counter, deque
import dataclasses
import math
from typing import NamedTuple

import numpy as np

from carracing_dqn.simulation.referee_settings import PATH, RefereeSettings, TOPIC
from msgs_bridge import topics
from msgs_bridge.errors import MessageError
from msgs_bridge.plain_text import plain
from msgs_bridge.stamps import NANOSECONDS
from msgs_bridge.step import CONTRACT_VERSION, read_step, Step
from msgs_bridge.twists import Command

# messages of odometry and twists that are kept, and frames that wait to be judged
KEPT = 1000
MOST_WAITING = 500
# images of one stamp in a row, or that jump, from which on it is told what the stamps do
MOST_AGAIN = 10
# characters that tell one frame of coordinates from another
LONGEST_FRAME_NAME = 40
MOST_POINTS = 100_000
# of a path: how far away its points may be, and from what length on a piece of it is one; m
MOST_METRES, LEAST_PIECE = 1e9, 1e-100
# a path whose ends are no farther apart than so many times its longest piece is closed
CLOSING_PIECES = 1.5
# along a path nobody gets farther than so many times the way driven
MOST_GAIN = 2.0
ODOM, COLLISION = topics.ODOMETRY.name, topics.COLLISION.name
LANE_OFFSET, GOAL = topics.LANE_OFFSET.name, topics.GOAL_DISTANCE.name
THE_PATH = topics.PATH.name


class Pose(NamedTuple):
    """Where a robot is: m and rad in the frame of its odometry."""

    x: float
    y: float
    yaw: float


def yaw_of(x: float, y: float, z: float, w: float) -> float:
    """
    Return the rotation about z of a quaternion of any length, rad.

    Raises:
        MessageError: it is no rotation, as the zeros of who knows no orientation are none.
    """
    length = math.hypot(x, y, z, w)
    if not 0.0 < length < math.inf:
        raise MessageError(f'odometry without an orientation: x {x:g}, y {y:g}, z {z:g}, w {w:g}')
    x, y, z, w = x / length, y / length, z / length, w / length
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


class Place(NamedTuple):
    """Where a robot is on a path: m along it, m to the left of it."""

    along: float
    offset: float


@dataclasses.dataclass(frozen=True)
class Judgement:
    """
    What is published for one image.

    Attributes:
        stamp: of the image, ns.
        step: what goes out as `step`; None for an episode that was cut off between two images.
        episode: what goes out as `episode` when one begins or has ended, else None.
    """

    stamp: int
    step: Step | None
    episode: dict[str, float] | None


class _Image(NamedTuple):
    """An image that waits, with what had come before it without a stamp of its own."""

    stamp: int
    seen: float
    collided: bool
    numbers: dict[str, tuple[float, float]]


@dataclasses.dataclass(frozen=True)
class _Sight:
    """What is known at one image."""

    stamp: int
    pose: Pose | None = None
    place: Place | None = None
    lane_offset: float = 0.0
    goal_distance: float = 0.0
    collided: bool = False


class Path:
    """A polyline to follow, closed if its ends meet."""

    def __init__(self, points: np.ndarray) -> None:
        """
        Take points (N, 2) in m.

        Raises:
            MessageError: no path: fewer than two points, too many, or too far away.
        """
        # what is not finite is not within it either
        if not 2 <= len(points) <= MOST_POINTS or not (np.abs(points) <= MOST_METRES).all():
            raise MessageError(f'path of {len(points)} points; accepted: 2 to {MOST_POINTS}, '
                               f'within {MOST_METRES:g} m')
        lengths = np.hypot(*np.diff(points, axis=0).T)
        # shorter pieces have no square, which is divided by
        if not (lengths > LEAST_PIECE).any():
            raise MessageError('path whose points are all the same')
        gap = math.hypot(*(points[-1] - points[0]))
        self.closed = bool(gap <= CLOSING_PIECES * lengths.max()) and len(points) > 2
        if self.closed:
            points = np.vstack([points, points[:1]])
        pieces = np.diff(points, axis=0)
        lengths = np.hypot(*pieces.T)
        kept = lengths > LEAST_PIECE
        self._starts, self._pieces, self._lengths = points[:-1][kept], pieces[kept], lengths[kept]
        self._along = np.concatenate([[0.0], np.cumsum(self._lengths)])
        self.length = float(self._along[-1])

    def place(self, x: float, y: float) -> Place:
        """Return the nearest place on the path."""
        away = np.array([x, y]) - self._starts
        share = (np.einsum('nk,nk->n', away, self._pieces) / self._lengths ** 2).clip(0.0, 1.0)
        rest = away - share[:, None] * self._pieces
        index = int(np.einsum('nk,nk->n', rest, rest).argmin())
        piece, off = self._pieces[index], rest[index]
        side = math.copysign(1.0, piece[0] * off[1] - piece[1] * off[0])
        return Place(float(self._along[index] + share[index] * self._lengths[index]),
                     side * float(math.hypot(*off)))

    def gained(self, before: Place, after: Place) -> float:
        """Return how far along the path it went, by the shorter way round a closed one."""
        along = after.along - before.along
        return math.remainder(along, self.length) if self.closed else along


class Referee:
    """
    Judges the frames of a robot, and says where its episodes begin and end.

    Attributes:
        counts: events, for the diagnostics.
        missing: why frames are left out now, a text by topic.
        published: names of the topics that somebody publishes; to be kept up to date.
        resetting: whether it waits for `reset_done`.
        again: how many images in a row have come with the stamp of the one before.
        jumps: how many in a row have cut an episode off by their stamps.
    """

    def __init__(self, settings: RefereeSettings) -> None:
        """Wait for the first image."""
        self.counts: Counter[str] = Counter()
        self.missing: dict[str, str] = {}
        self._lacking: dict[str, str] = {}
        self.published: set[str] = set()
        self.resetting = False
        self.needed = needed_topics(settings)
        self._settings = settings
        self._gap = round(settings.sequence_gap * NANOSECONDS)
        self._waiting: deque[_Image] = deque()
        self._poses: deque[tuple[int, Pose]] = deque(maxlen=KEPT)
        self._twists: deque[tuple[int, Command]] = deque(maxlen=KEPT)
        self._numbers: dict[str, tuple[float, float]] = {}
        # frames of coordinates by topic, '' where none was named
        self._coordinates: dict[str, str] = {}
        self.again = self.jumps = 0
        self._collided = False
        self._path: Path | None = None
        self.episode = -1
        self._running = False
        self._begin_from: int | None = None
        self._last: Step | None = None
        self._sight: _Sight | None = None

    @property
    def running(self) -> bool:
        """Return whether an episode runs."""
        return self._running

    def see_image(self, stamp: int, now: float) -> None:
        """
        Take an image by its stamp in ns, at a wall time in s; one sent again is left out.

        Flags and numbers that have come by now are those of this image.
        """
        newest = self._waiting[-1].stamp if self._waiting else self._sight and self._sight.stamp
        if stamp == newest:
            self.again += 1
            self.counts['images_sent_again'] += 1
            return
        self.again = 0
        if len(self._waiting) == MOST_WAITING:
            self._leave_out()
        self._waiting.append(_Image(stamp, now, self._collided, dict(self._numbers)))
        self._collided = False

    def hear_twist(self, stamp: int, command: Command) -> None:
        """Take a twist by the stamp of the image that it answers."""
        if self._twists and stamp < self._twists[-1][0]:
            self._twists.clear()
        self._twists.append((stamp, command))

    def hear_odometry(self, stamp: int, pose: Pose, frame_id: str = '') -> None:
        """
        Take where the robot was at a stamp in ns, by coordinates of a frame.

        Raises:
            MessageError: not finite.
        """
        if not all(map(math.isfinite, pose)):
            raise MessageError(f'odometry that is not finite: {tuple(pose)}')
        self._coordinates[ODOM] = _frame_name(frame_id)
        if self._poses and stamp < self._poses[-1][0]:
            self._poses.clear()
        self._poses.append((stamp, pose))

    def hear_collision(self, collided: bool) -> None:
        """Take a flag; one that was up counts for the next image."""
        self._collided = self._collided or collided

    def hear_number(self, topic: str, value: float, now: float) -> None:
        """
        Take a lane offset or a distance from the goal in m, at a wall time in s.

        Raises:
            MessageError: not finite, or a distance below 0, by which some say that they know none.
        """
        if not math.isfinite(value) or topic == GOAL and value < 0:
            raise MessageError(f'{topic} is {value:g}')
        self._numbers[topic] = value, now

    def hear_path(self, points: np.ndarray, frame_id: str = '') -> None:
        """
        Take the path to follow from now on, (N, 2) in m by coordinates of a frame.

        Raises:
            MessageError: it is none.
        """
        self._path = Path(points)
        self._coordinates[THE_PATH] = _frame_name(frame_id)
        # along another path nothing is gained yet
        if self._sight is not None and self._sight.pose is not None:
            self._sight = dataclasses.replace(
                self._sight, place=self._path.place(self._sight.pose.x, self._sight.pose.y))

    def reset_done(self) -> None:
        """Take that the robot stands where the next episode begins."""
        self.resetting = False

    def cut_off(self) -> Judgement | None:
        """End the running episode where it is, if there is one."""
        if not self._running:
            return None
        self.counts['cut_off'] += 1
        self._running = False
        stamp = self._sight.stamp
        self._rest_from(stamp)
        return Judgement(stamp, None, {**self._summary(self._last), 'truncated': 1.0})

    def judge(self, now: float) -> list[Judgement]:
        """Return what can be said by a wall time in s of the images that wait."""
        found: list[Judgement] = []
        while self._waiting:
            image = self._waiting[0]
            stamp = image.stamp
            if not self._running and self._is_between(stamp):
                self._waiting.popleft()
                self.counts['frames_between_episodes'] += 1
                continue
            if self._running and not 0 < stamp - self._sight.stamp <= self._gap:
                # a robot that somebody else has set back
                self.jumps += 1
                found.append(self.cut_off())
                self._begin_from, self.resetting = None, False
                continue
            sight = self._look(image)
            late = now - image.seen
            if sight is None:
                if late < self._settings.input_timeout:
                    break
                self.missing = self._lacking
                self._leave_out()
                continue
            if (self._running and late < self._settings.twist_patience
                    and not any(heard == self._sight.stamp for heard, _ in self._twists)):
                break
            judgement = self._go_on(sight) if self._running else self._begin(sight)
            if judgement is None:
                self.missing = self._lacking
                self._leave_out()
                continue
            self._waiting.popleft()
            self.missing = {}
            found.append(judgement)
        return found

    def _is_between(self, stamp: int) -> bool:
        return self.resetting or (
            self._begin_from is not None
            # stamps that start anew are after a restart, not before the end
            and self._begin_from - 2 * self._gap <= stamp < self._begin_from)

    def _rest_from(self, stamp: int) -> None:
        self._begin_from = stamp + self._gap
        self.resetting = bool(self._settings.reset_service)

    def _leave_out(self) -> None:
        image = self._waiting.popleft()
        self.counts['frames_not_judged'] += 1
        if image.collided:
            # it happened all the same: the next frame that can be judged bears it
            self._collided = self._collided or not self._waiting
            if self._waiting:
                self._waiting[0] = self._waiting[0]._replace(collided=True)
        if self._running:
            # what comes next is no successor of what was judged last
            self._last = dataclasses.replace(self._last, decision=self._last.decision + 1)

    def _look(self, image: _Image) -> _Sight | None:
        """Return what is known at an image, None and what is `_lacking` if that is not enough."""
        self._lacking = {
            topic: f'nobody publishes it, {terms} needs it'
            for topic, terms in self.needed.items() if topic not in self.published}
        needed = [topic for topic in self.needed if topic not in self._lacking]
        sight = _Sight(image.stamp, collided=image.collided)
        if ODOM in needed:
            sight = dataclasses.replace(sight, pose=self._pose_at(image.stamp))
        for topic in (LANE_OFFSET, GOAL):
            if topic in needed:
                value, heard = image.numbers.get(topic, (math.nan, -math.inf))
                if image.seen - heard > self._settings.input_timeout:
                    self._lacking[topic] = 'nothing has come lately'
                sight = dataclasses.replace(sight, **{topic: value})
        if THE_PATH in needed and self._path is None:
            self._lacking[THE_PATH] = 'nothing has come yet'
        elif THE_PATH in needed and ODOM in needed:
            ours, theirs = (self._coordinates.get(one, '') for one in (ODOM, THE_PATH))
            if ours and theirs and ours != theirs:
                self._lacking[THE_PATH] = (
                    f'it is in the frame {theirs!r}, odom in {ours!r}; both must be in one')
        if self._lacking:
            return None
        if self._path is not None and sight.pose is not None:
            place = self._path.place(sight.pose.x, sight.pose.y)
            sight = dataclasses.replace(sight, place=place)
            if self._settings.lane == PATH:
                sight = dataclasses.replace(sight, lane_offset=place.offset)
        return sight

    def _pose_at(self, stamp: int) -> Pose | None:
        """Return the newest pose up to a stamp, once nothing newer can come."""
        newest = self._poses[-1][0] if self._poses else None
        if newest is None:
            self._lacking[ODOM] = 'nothing has come yet'
        elif newest < stamp:
            self._lacking[ODOM] = f'it is {(stamp - newest) / NANOSECONDS:.3g} s behind image_raw'
        else:
            for at, pose in reversed(self._poses):
                if at <= stamp:
                    return pose
            self._lacking[ODOM] = 'it begins after the image'
        return None

    def _begin(self, sight: _Sight) -> Judgement | None:
        step = Step(0.0, False, False, self.episode + 1, 0, 0.0, -1, None,
                    self._info(sight, 0, 0.0, 0.0, None, goal=False))
        if self._nobody_reads(step, sight):
            return None
        self._running = True
        self._begin_from = None
        self.episode += 1
        self._started, self._unanswered = sight.stamp, 0
        self._sight, self._last = sight, step
        return Judgement(sight.stamp, step, self._summary(step))

    def _go_on(self, sight: _Sight) -> Judgement | None:
        """Return what is said of a frame that follows, None and what is `_lacking` if nothing."""
        settings, before, last = self._settings, self._sight, self._last
        seconds = (sight.stamp - before.stamp) / NANOSECONDS
        ahead = gained = nearer = 0.0
        if before.pose is not None:
            x, y = sight.pose.x - before.pose.x, sight.pose.y - before.pose.y
            yaw = before.pose.yaw
            ahead = x * math.cos(yaw) + y * math.sin(yaw)
            if self._path is not None:
                most = MOST_GAIN * math.hypot(x, y)
                gained = max(-most, min(most, self._path.gained(before.place, sight.place)))
        if GOAL in self.needed:
            nearer = before.goal_distance - sight.goal_distance
        goal = settings.goal_radius > 0 and sight.goal_distance <= settings.goal_radius
        reward = (settings.forward_weight * ahead + settings.progress_weight * gained
                  + settings.goal_weight * nearer + settings.goal_reward * goal
                  - settings.lane_offset_penalty * abs(sight.lane_offset) * seconds
                  - settings.collision_penalty * sight.collided
                  - settings.time_penalty * seconds)
        terminated = (
            goal or (settings.collision_ends and sight.collided)
            or 0 < settings.off_lane < abs(sight.lane_offset))
        truncated = (not terminated and 0 < settings.time_limit
                     <= (sight.stamp - self._started) / NANOSECONDS)
        applied, command = self._applied(before.stamp)
        step = Step(
            reward, terminated, truncated, self.episode, last.decision + 1,
            last.episode_return + reward, -1, applied,
            self._info(sight, last.decision + 1, ahead, gained, command, goal=goal))
        if self._nobody_reads(step, sight, ahead, gained, nearer):
            return None
        self._unanswered += applied is None
        self._sight, self._last = sight, step
        self.jumps = 0
        if not step.ended:
            return Judgement(sight.stamp, step, None)
        self._running = False
        self._rest_from(sight.stamp)
        return Judgement(sight.stamp, step, self._summary(step))

    def _nobody_reads(
        self, step: Step, sight: _Sight, ahead: float = 0.0, gained: float = 0.0,
        nearer: float = 0.0,
    ) -> bool:
        """Return whether a step is none that can be sent; `_lacking` has the topic to blame."""
        try:
            read_step(step.values())
        except MessageError as error:
            lane = THE_PATH if self._settings.lane == PATH else LANE_OFFSET
            said = ((ODOM, ahead), (THE_PATH, gained), (lane, sight.lane_offset), (GOAL, nearer))
            _, topic = max((abs(value) if math.isfinite(value) else math.inf, topic)
                           for topic, value in said)
            self._lacking = {topic: f'what it says cannot be judged by: {error}'}
            return True
        return False

    def _applied(self, stamp: int) -> tuple[int | None, Command | None]:
        """Return stamp and command of the twist that was applied since an image."""
        oldest = max(self._started, stamp - round(self._settings.stale_after * NANOSECONDS))
        for answers, command in reversed(self._twists):
            if oldest <= answers <= stamp:
                return answers, command
        return None, None

    def _info(
        self, sight: _Sight, decision: int, ahead: float, gained: float, command: Command | None,
        *, goal: bool,
    ) -> dict[str, float]:
        linear, angular = command or (0.0, 0.0)
        info = {'step': decision, 'frames': float(decision > 0),
                'linear': linear, 'angular': angular}
        if ODOM in self.needed:
            info['ahead'] = ahead
        if THE_PATH in self.needed:
            info['gained'] = gained
        if LANE_OFFSET in self.needed or self._settings.lane == PATH:
            info[LANE_OFFSET] = sight.lane_offset
        if COLLISION in self.needed:
            info[COLLISION] = sight.collided
        if GOAL in self.needed:
            info.update({GOAL: sight.goal_distance, 'goal_reached': goal})
        return {name: float(value) for name, value in info.items()}

    def _summary(self, step: Step) -> dict[str, float]:
        values = {
            'contract_version': CONTRACT_VERSION, 'episode': step.episode, 'seed': -1,
            'decisions': step.decision, 'episode_return': step.episode_return,
            'terminated': step.terminated, 'truncated': step.truncated,
            'unanswered': self._unanswered, 'frame_seconds': self._settings.frame_seconds,
            'action_repeat': 1}
        if GOAL in self.needed:
            values['goal_reached'] = step.info['goal_reached']
        return {name: float(value) for name, value in values.items()}


def _frame_name(frame_id: str) -> str:
    # older robots write a / before it
    return plain(frame_id.removeprefix('/'), LONGEST_FRAME_NAME)


def needed_topics(settings: RefereeSettings) -> dict[str, str]:
    """Return the topics that terms and ends need, each with the names of those."""
    lane = [name for name in ('lane_offset_penalty', 'off_lane') if getattr(settings, name)]
    by_topic = {
        ODOM: [*(name for name in ('forward_weight', 'progress_weight')
                 if getattr(settings, name)), *(lane if settings.lane == PATH else ())],
        THE_PATH: [*(['progress_weight'] if settings.progress_weight else ()),
                   *(lane if settings.lane == PATH else ())],
        LANE_OFFSET: lane if settings.lane == TOPIC else [],
        GOAL: [name for name in ('goal_weight', 'goal_radius') if getattr(settings, name)],
        COLLISION: [name for name in ('collision_penalty', 'collision_ends')
                    if getattr(settings, name)]}
    return {topic: ', '.join(names) for topic, names in by_topic.items() if names}
