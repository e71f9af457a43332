# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Demonstrations: what somebody else drove, kept where no transition of the run overwrites it.

A run has them from one file in its folder, made once from bags: transitions as the replay buffer
keeps them, encoded and shaped for the settings of the run. So a run that goes on needs no bag.
"""
from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
import dataclasses
import hashlib
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from dqn_policy_node.action_limits import TOLERANCE
from dqn_policy_node.action_space import ActionSpace
from dqn_policy_node.preprocessing import Preprocessor
from msgs_bridge.errors import MessageError
from msgs_bridge.stamps import NANOSECONDS
from msgs_bridge.transitions import Transition
from msgs_bridge.twists import Command
from trainer_node.checkpoint_file import read_checkpoint, write_checkpoint
from trainer_node.errors import LearningError, RunError
from trainer_node.hyperparameters import Hyperparameters
from trainer_node.replay_buffer import make_replay, ReplayBuffer
from trainer_node.saved_state import from_json
from trainer_node.shaping import REWARD_SETTINGS, Shaping

FORMAT = 'carracing_dqn demonstrations 1'
MOST_OBSERVATIONS = 1_000_000
# half of what a checkpoint file may have, in which they are kept
MOST_BYTES = 2**31
# share of a decision by which one may be longer or shorter: stamps of a camera are never even
UNEVEN = 0.1
# decisions that are not of their length beyond those that are, before a recording is refused
MOST_UNEVEN = 2
OBSERVATIONS = 'observations'


@dataclasses.dataclass(frozen=True)
class Summary:
    """
    What demonstrations are, and how well the action space holds them.

    Attributes:
        sources: names of the recordings.
        episodes: that were driven to their end.
        mean_return: of those, the environment's own; 0 without any.
        decisions: how many.
        foreign: how many of them no action of the space meant.
        distance_mean, distance_worst: from the command of a decision to that of the action taken
            for it, the larger of both axes' differences; over all decisions.
        left_out: decisions that could not be used.
    """

    sources: list[str]
    episodes: int
    mean_return: float
    decisions: int
    foreign: int
    distance_mean: float
    distance_worst: float
    left_out: int

    def __str__(self) -> str:
        """Return it in one line."""
        return (f'{self.decisions} decisions of {self.episodes} episodes, mean return '
                f'{self.mean_return:.1f}; {self.foreign} decisions are no action of the space and '
                f'were taken for the nearest: {self.distance_mean:.3f} away in the mean of all, '
                f'{self.distance_worst:.3f} at worst'
                + (f'; {self.left_out} decisions were left out' if self.left_out else ''))


@dataclasses.dataclass(frozen=True)
class Demonstrations:
    """
    Demonstrations for the settings of one run.

    Attributes:
        replay: holds them and nothing else.
        summary: what they are.
        made_for: the settings and the model that they are encoded and shaped for, as JSON.
    """

    replay: ReplayBuffer
    summary: Summary
    made_for: dict[str, Any]

    @property
    def sha256(self) -> str:
        """Return a digest of what is learned from."""
        digest = hashlib.sha256(json.dumps(self.made_for, sort_keys=True).encode())
        for name, array in sorted(self._arrays().items()):
            digest.update(name.encode())
            digest.update(np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()

    def _arrays(self) -> dict[str, np.ndarray]:
        return {**self.replay.state_arrays(),
                OBSERVATIONS: self.replay.observations(0, self.replay.written)}

    def write(self, path: Path) -> None:
        """
        Write the file whole or not at all.

        Raises:
            RunError: it cannot be written.
        """
        try:
            write_checkpoint(path, self._arrays(), {
                'summary': dataclasses.asdict(self.summary), 'made_for': self.made_for,
                'written': self.replay.written}, FORMAT)
        except OSError as error:
            raise RunError(f'{path} cannot be written: {error.strerror}') from None


def collect(
    settings: Hyperparameters, transitions: Iterable[Transition], sources: Iterable[str],
) -> Demonstrations:
    """
    Return the demonstrations that transitions of frames hold.

    Args:
        settings: of the run that learns from them.
        transitions: in order, of frames that are as far apart as decisions, or nearer.
        sources: names of where they come from.

    Raises:
        LearningError: a shaping term lacks what it needs, the frames are further apart than
            decisions, there are too many of them, or no transition at all.
    """
    description = settings.model_description()
    space, shaping = description.action_space, Shaping(settings)
    preprocess = Preprocessor(description.preprocessing)
    most = min(MOST_OBSERVATIONS, MOST_BYTES // math.prod(description.preprocessing.shape))
    kept: list[tuple[np.ndarray | None, tuple[Any, float, np.ndarray, bool]]] = []
    counts: Counter[str] = Counter()
    returns, distances = [], []
    segment_end = None
    for decision in as_decisions(transitions, description.stack_seconds, counts):
        if decision.step.ended:
            returns.append(decision.step.episode_return)
        try:
            reward = shaping.reward(decision)
            after = preprocess(decision.next_frame)
            first = preprocess(decision.frame) if decision.stamp != segment_end else None
        except MessageError:
            counts['left_out'] += 1
            segment_end = None
            continue
        counts['observations'] += 1 if first is None else 2
        if counts['observations'] > most:
            raise LearningError(f'more than {most} observations of demonstrations')
        action, distance = nearest(space, decision.command)
        distances.append(distance)
        kept.append((first, (action, reward, after, shaping.terminated(decision))))
        segment_end = None if decision.step.ended else decision.next_stamp
    if not distances:
        raise LearningError('the demonstrations hold no transition')
    replay = make_replay(settings, counts['observations'])
    for first, (action, reward, after, terminated) in kept:
        if first is not None:
            replay.start(first)
        replay.add(action, reward, after, terminated=terminated)
    found = np.array(distances)
    return Demonstrations(replay, Summary(
        list(sources), len(returns), float(np.mean(returns)) if returns else 0.0, len(found),
        int(np.count_nonzero(found > TOLERANCE)), float(found.mean()), float(found.max()),
        counts['left_out'] + counts['uneven']), _made_for(settings))


def nearest(space: ActionSpace, command: Command) -> tuple[Any, float]:
    """Return the encoded action that is nearest to a command, and how far away it is."""
    action = space.nearest(command)
    return action, max(abs(given - own) for given, own in zip(command, space.decode(action)))


def as_decisions(
    transitions: Iterable[Transition], seconds: float, counts: Counter[str] | None = None,
) -> Iterator[Transition]:
    """
    Join transitions of frames into decisions that are nearest to some seconds.

    The command of a decision is the mean of its frames', the reward their sum. What is cut off
    by a gap is passed over, and what a late frame makes too long; what is cut off by the end of
    an episode is a shorter decision, as a simulator makes it.

    Args:
        transitions: in order.
        seconds: that a decision lasts.
        counts: what is passed over because of its length is counted here as `uneven`.

    Raises:
        LearningError: no number of frames is as long as a decision.
    """
    wanted = seconds * NANOSECONDS
    counts = Counter() if counts is None else counts
    even = 0
    group: list[Transition] = []
    for transition in transitions:
        if group and group[-1].next_stamp != transition.stamp:
            group = []
        group.append(transition)
        frame = transition.next_stamp - transition.stamp
        beside = transition.next_stamp - group[0].stamp - wanted
        cut_off = transition.step.ended and beside < 0
        if not cut_off and beside + frame / 2 < 0:
            continue
        if cut_off or abs(beside) <= UNEVEN * wanted:
            even += 1
            yield _joined(group)
        else:
            counts['uneven'] += 1
            if counts['uneven'] > even + MOST_UNEVEN:
                raise LearningError(
                    f'frames of the recording are {frame / NANOSECONDS:g} s apart, of which no '
                    f'number makes a decision of {seconds:g} s (action_repeat)')
        group = []


def _joined(group: list[Transition]) -> Transition:
    first, last = group[0], group[-1]
    weights = [one.next_stamp - one.stamp for one in group]
    command = Command(*(float(np.average(values, weights=weights))
                        for values in zip(*(one.command for one in group))))
    return dataclasses.replace(
        first, next_stamp=last.next_stamp, next_frame=last.next_frame, command=command,
        step=dataclasses.replace(last.step, reward=sum(one.step.reward for one in group)))


def read_demonstrations(path: Path, settings: Hyperparameters) -> Demonstrations:
    """
    Read what `Demonstrations.write` wrote.

    Raises:
        RunError: the file is not there or damaged, or is made for other settings than these; the
            text says which.
    """
    arrays, state = read_checkpoint(path, FORMAT)
    made_for = _made_for(settings)
    try:
        summary = from_json(Summary, state['summary'], 'summary')
        written = int(state['written'])
        different = [name for name, value in made_for.items()
                     if state['made_for'].get(name) != value]
        if different:
            raise RunError(f'{path} was made for another {", ".join(different)}; make it anew '
                           'from the bags, with --demonstrations')
        if not 0 < written <= MOST_OBSERVATIONS:
            raise ValueError(f'{written} observations')
        replay = make_replay(settings, written)
        observations = arrays.pop(OBSERVATIONS)
        replay.load_state(arrays, written)
        replay.put_observations(0, observations)
        space = settings.model_description().action_space
        if not (np.all((arrays['actions'] >= -1) & (arrays['actions'] < len(space)))
                and np.isfinite(arrays['rewards']).all()):
            raise ValueError('an action that there is not, or a reward that is none')
    except (KeyError, ValueError, TypeError, AttributeError, IndexError, OverflowError) as error:
        if isinstance(error, RunError):
            raise
        raise RunError(f'{path}: damaged demonstrations: {str(error)[:200]}') from None
    return Demonstrations(replay, summary, made_for)


def _made_for(settings: Hyperparameters) -> dict[str, Any]:
    """Return what the contents depend on, by name."""
    description = settings.model_description()
    return {'preprocessing': dataclasses.asdict(description.preprocessing),
            'action_space': description.action_space.to_json(),
            'stack_seconds': description.stack_seconds,
            **{name: getattr(settings, name) for name in REWARD_SETTINGS}}
