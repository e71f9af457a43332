# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
What travels in the JointState bundles of the contract, each name described once.

`docs/contract.md` explains them. A `step` has a small core, which every simulator owes, and any
number of further named values, its info, which is there for whoever asks for it by name.
"""
from __future__ import annotations

from collections.abc import Collection, Mapping
import dataclasses
import math

from msgs_bridge.errors import MessageError
from msgs_bridge.stamps import NANOSECONDS

# 1: version 0.1 of the package, which says nothing of its contract and sends what is constant
# for a run with every `step` instead of with `episode`
CONTRACT_VERSION = 2

STEP_CORE = {
    'reward': "the environment's own reward since the frame before, summed over repeated frames",
    'terminated': '1 on the last frame of an episode that ended by the rules',
    'truncated': '1 on the last frame of an episode that was cut off',
    'episode': 'number of the episode, from 0',
    'decision': 'number of the published frame within its episode, from 0 (the reset frame)',
    'episode_return': 'sum of rewards so far in the episode',
    'seed': 'seed of the episode; -1 when it came from the stream of an earlier seed, or is none',
    'applied_sec': 'seconds of the stamp of the twist applied; -1 when none was',
    'applied_nanosec': 'nanoseconds of that stamp',
}

# what the simulator node of this package adds for every simulator
STEP_INFO = {
    'step': 'simulated frames since the start of the episode',
    'frames': 'simulated frames since the frame before (less than action_repeat at an end)',
    'linear': 'command applied since the frame before, -1 (brake) to 1 (gas)',
    'angular': 'command applied since the frame before, -1 (right) to 1 (left)',
}

EPISODE_CORE = {
    'contract_version': 'version of the topic contract',
    'episode': 'number of the episode, from 0',
    'seed': 'as in step',
    'decisions': 'frames published after the reset frame; 0 when the episode begins',
    'episode_return': 'sum of rewards',
    'terminated': '1 when it has ended by the rules',
    'truncated': '1 when it was cut off; neither when it begins',
    'unanswered': 'frames that no twist answered in time',
    'frame_seconds': 'constant of the run: seconds of one simulated frame',
    'action_repeat': 'constant of the run: simulated frames for each published one',
}

VALIDATION_FIELDS = {
    'version': 'version of the weights that drove',
    'episodes': 'episodes driven',
    'mean': 'mean return',
    'std': 'standard deviation of the returns (population)',
    'minimum': 'lowest return',
    'maximum': 'highest return',
    'completed': 'share of the episodes that reached their goal (all tiles visited), 0 to 1',
    'seconds': 'wall time it took',
}

Q_VALUE_EXTRAS = {
    'chosen': 'index of the output of the action that was sent; of the nearest node of its first '
              'axis, where it has any',
    'explored': '1 when it was drawn at random',
    'weights_version': 'version of the weights that computed them',
}

Q_VALUE_AXES = {
    'chosen_second': 'only where the action space has axes: as `chosen`, of the second axis; -1 '
                     'for none',
}
"""What `q_values` has of action spaces with axes beside `Q_VALUE_EXTRAS`."""

# beyond this a reward is no reward: the replay keeps float32, and sums must stay finite
MAX_REWARD = 1e9
# whole numbers up to here are exact in a float64
MAX_WHOLE = 2**53
MAX_SECONDS = 2**31 - 1
MAX_NAMES = 256
MAX_NAME_LENGTH = 100


@dataclasses.dataclass(frozen=True)
class Step:
    """
    One `step` message that was found good.

    Attributes:
        reward: since the frame before; 0 on a reset frame.
        terminated, truncated: whether the episode ended here by its rules, or was cut off.
        episode, decision: numbers of the episode and of the frame in it, from 0.
        episode_return: sum of the rewards of the episode so far.
        seed: of the episode; -1 for none of its own.
        applied: stamp in ns of the twist that was applied; None when none was.
        info: every further value by name, all finite.
    """

    reward: float
    terminated: bool
    truncated: bool
    episode: int
    decision: int
    episode_return: float
    seed: int
    applied: int | None
    info: dict[str, float]

    @property
    def ended(self) -> bool:
        """Return whether nothing of this episode follows."""
        return self.terminated or self.truncated

    def values(self) -> dict[str, float]:
        """Return the values of the bundle, as `read_step` takes them."""
        seconds, nanoseconds = (
            (-1, 0) if self.applied is None else divmod(self.applied, NANOSECONDS))
        values = {
            'reward': self.reward, 'terminated': self.terminated, 'truncated': self.truncated,
            'episode': self.episode, 'decision': self.decision,
            'episode_return': self.episode_return, 'seed': self.seed,
            'applied_sec': seconds, 'applied_nanosec': nanoseconds, **self.info}
        return {name: float(value) for name, value in values.items()}


def check_names(what: str, names: Collection[str]) -> None:
    """Raise MessageError for too many names, or one that is too long, of what is called `what`."""
    if len(names) > MAX_NAMES:
        raise MessageError(f'{what} has {len(names)} values; accepted: up to {MAX_NAMES}')
    longest = max(map(len, names), default=0)
    if longest > MAX_NAME_LENGTH:
        raise MessageError(
            f'{what} has a name of {longest} characters; accepted: up to {MAX_NAME_LENGTH}')


def read_step(values: Mapping[str, float]) -> Step:
    """
    Return the step of a bundle's values: the one reader, live and from bags.

    Raises:
        MessageError: a value of the core is missing or out of range, or any value is not finite.
    """
    info = dict(values)
    check_names('step', info)
    for name, value in info.items():
        if not math.isfinite(value):
            raise MessageError(f'{name} is {value}')
    try:
        core = {name: info.pop(name) for name in STEP_CORE}
    except KeyError as error:
        raise MessageError(f'step lacks {error.args[0]!r}') from None
    for name in ('reward', 'episode_return'):
        if abs(core[name]) > MAX_REWARD:
            raise MessageError(f'{name} is {core[name]:g}; accepted: up to {MAX_REWARD:g}')
    return Step(
        core['reward'], core['terminated'] > 0, core['truncated'] > 0,
        _whole(core, 'episode', 0, MAX_WHOLE), _whole(core, 'decision', 0, MAX_WHOLE),
        core['episode_return'], _whole(core, 'seed', -1, MAX_WHOLE), _applied(core), info)


def _applied(core: Mapping[str, float]) -> int | None:
    if core['applied_sec'] < 0:
        return None
    return (_whole(core, 'applied_sec', 0, MAX_SECONDS) * NANOSECONDS
            + _whole(core, 'applied_nanosec', 0, NANOSECONDS - 1))


def _whole(values: Mapping[str, float], name: str, low: int, high: int) -> int:
    value = values[name]
    if not low <= value <= high or int(value) != value:
        raise MessageError(f'{name} is {value:g}; accepted: whole numbers from {low} to {high}')
    return int(value)
