# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
The replay buffer: every observation once, samples by a few vectorised reads.

Observations lie in a ring in the order they came, those of several sources mixed. A slot holds an
observation and, once it is known, what was done on seeing it: action, reward and whether the rules
ended the episode there. Each slot knows how far before and after it the neighbours in its segment
lie, which are of its own source. The last observation of a segment has no action, so whatever
walks forward from a slot stops there; the first one has none before it, so whatever looks back
stays there.

One ring serves all sources: a source that is gone keeps no room, and a uniform draw takes from
each in proportion to what it has sent.
"""
from __future__ import annotations

from typing import NamedTuple

import numpy as np

from trainer_node.errors import LearningError
from trainer_node.hyperparameters import Hyperparameters
from trainer_node.stack_gather import gather_stacks


class Batch(NamedTuple):
    """
    Samples for one update.

    Attributes:
        observations: uint8 (B, stack, H, W), oldest first, channels last in memory.
        actions: encoded actions of the action space, (B, ...).
        rewards: float32 (B,), discounted sum over up to n steps.
        next_observations: uint8 (B, stack, H, W), what was seen after those steps.
        discounts: float32 (B,), factor on the value of `next_observations`; 0 where the rules
            ended the episode, a cut-off episode goes on being worth something.
        demonstrated: how many of the first samples were demonstrated.
    """

    observations: np.ndarray
    actions: np.ndarray
    rewards: np.ndarray
    next_observations: np.ndarray
    discounts: np.ndarray
    demonstrated: int = 0


class ReplayBuffer:
    """
    A ring of observations and what was done on seeing them.

    Args:
        capacity: observations that fit.
        shape: height and width of an observation.
        frame_stack: observations in a stack.
        n_steps: rewards that are added up before bootstrapping.
        gamma: discount of one step.
        action_dtype, action_shape: of an encoded action (`dqn_policy_node.action_space`).
    """

    _ARRAYS = ('actions', 'rewards', 'terminated', 'acted', 'ages')
    _OF_SEVERAL = ('sources',)

    def __init__(
        self, capacity: int, shape: tuple[int, int], *, frame_stack: int = 1, n_steps: int = 1,
        gamma: float = 0.99, action_dtype: np.dtype | type = np.uint8,
        action_shape: tuple[int, ...] = (),
    ) -> None:
        """Reserve the memory; pages are taken as they are filled."""
        self.capacity = capacity
        self.frame_stack = frame_stack
        self.n_steps = n_steps
        self.gamma = gamma
        self._observations = np.empty((capacity, *shape), np.uint8)
        self._actions = np.zeros((capacity, *action_shape), action_dtype)
        self._rewards = np.zeros(capacity, np.float32)
        self._terminated = np.zeros(capacity, bool)
        self._acted = np.zeros(capacity, bool)
        self._ages = np.zeros(capacity, np.int32)
        self._sources = np.zeros(capacity, np.uint16)
        # slots to the neighbours in the segment; 0 back from the first
        self._back = np.zeros(capacity, np.int32)
        self._ahead = np.zeros(capacity, np.int32)
        # slots ever written; slot number n lies at n % capacity
        self.written = 0
        # number of the newest slot of each source
        self._newest: dict[int, int] = {}
        self._gathered = np.empty((0, *shape, frame_stack), np.uint8)

    def __len__(self) -> int:
        """Return the number of observations held."""
        return min(self.written, self.capacity)

    @property
    def transitions(self) -> int:
        """Return the number of transitions held."""
        return int(np.count_nonzero(self._acted[:len(self)]))

    def start(self, observation: np.ndarray, source: int = 0) -> None:
        """Begin a segment of a source with its first observation, uint8 (H, W)."""
        self._write(observation, 0, source, 0)

    def can_add(self, source: int = 0) -> bool:
        """Return whether the newest observation of a source will outlast the next one."""
        newest = self._newest.get(source)
        return newest is not None and newest > self.written - self.capacity

    def newest(self, source: int = 0) -> np.ndarray:
        """Return the newest observation of a source for which `can_add` holds, uint8 (H, W)."""
        return self._observations[self._newest[source] % self.capacity]

    def add(
        self, action: object, reward: float, next_observation: np.ndarray, *, terminated: bool,
        source: int = 0,
    ) -> None:
        """
        Add what a source did on seeing its newest observation, and the observation that followed.

        Args:
            action: the encoded action.
            reward: what it earned, shaped and scaled.
            next_observation: uint8 (H, W).
            terminated: whether the rules ended the episode. After any end call `start` next.
            source: whose it is, for which `can_add` holds; 0 to 65535.
        """
        distance = self.written - self._newest[source]
        newest = self._newest[source] % self.capacity
        self._actions[newest] = action
        self._rewards[newest] = reward
        self._terminated[newest] = terminated
        self._acted[newest] = True
        self._ahead[newest] = distance
        self._write(next_observation, int(self._ages[newest]) + 1, source, distance)

    def _write(self, observation: np.ndarray, age: int, source: int, back: int) -> None:
        slot = self.written % self.capacity
        self._observations[slot] = observation
        self._ages[slot] = age
        self._acted[slot] = False
        self._terminated[slot] = False
        self._sources[slot] = source
        self._back[slot] = back
        self._newest[source] = self.written
        self.written += 1

    def sample(self, batch_size: int, random: np.random.Generator) -> Batch:
        """
        Draw transitions uniformly, with replacement.

        The observations are views on memory that the next call overwrites.

        Raises:
            ValueError: no transition is held.
        """
        numbers = self._draw(batch_size, random)
        rewards, discounts, after = self._look_ahead(numbers)
        slots = numbers % self.capacity
        observations = self._stacks(np.concatenate([slots, after]))
        return Batch(
            observations[:batch_size], self._actions[slots], rewards, observations[batch_size:],
            discounts)

    def _draw(self, count: int, random: np.random.Generator) -> np.ndarray:
        """Return numbers of slots that hold an action and a whole stack, int64 (count,)."""
        low = max(self.written - self.capacity, 0)
        if low:
            low += self.frame_stack - 1
        high = self.written - 1
        if high <= low:
            raise ValueError('the replay buffer holds no transition')
        numbers = random.integers(low, high, count)
        for _ in range(20):
            wrong = np.flatnonzero(~self._usable(numbers))
            if not len(wrong):
                return numbers
            numbers[wrong] = random.integers(low, high, len(wrong))
        # hardly any slot holds an action: choose among those that do
        usable = np.arange(low, high)
        usable = usable[self._usable(usable)]
        if not len(usable):
            raise ValueError('the replay buffer holds no transition')
        return usable[random.integers(0, len(usable), count)]

    def _usable(self, numbers: np.ndarray) -> np.ndarray:
        """Return which slots hold an action and a whole stack, bool (N,)."""
        slots = numbers % self.capacity
        usable = self._acted[slots]
        if len(self._newest) > 1 and self.written > self.capacity:
            # between the observations of a stack there are those of other sources, and the first
            # ones of it may be overwritten
            reach = np.zeros(len(numbers), np.int64)
            for _ in range(self.frame_stack - 1):
                distances = self._back[slots]
                reach += distances
                slots = (slots - distances) % self.capacity
                # what was overwritten leads anywhere, but no further back than here
                usable = usable & (numbers - reach >= self.oldest)
        return usable

    def _look_ahead(self, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return rewards over up to n steps, discounts after them, and the slots after them."""
        rewards = np.zeros(len(numbers))
        discounts = np.ones(len(numbers))
        alive = np.ones(len(numbers), bool)
        ended = np.zeros(len(numbers), bool)
        slots = numbers % self.capacity
        for _ in range(self.n_steps):
            alive = alive & self._acted[slots]
            rewards += np.where(alive, discounts * self._rewards[slots], 0.0)
            discounts = np.where(alive, discounts * self.gamma, discounts)
            ended |= alive & self._terminated[slots]
            slots = (slots + alive * self._ahead[slots]) % self.capacity
        discounts[ended] = 0.0
        return rewards.astype(np.float32), discounts.astype(np.float32), slots

    def _stacks(self, newest: np.ndarray) -> np.ndarray:
        """Return the stacks that end at slots, uint8 (N, stack, H, W), channels last."""
        slots = np.empty((len(newest), self.frame_stack), np.int64)
        slots[:, -1] = newest
        for place in range(self.frame_stack - 2, -1, -1):
            # below 0 it counts from the end, as numpy does
            newest = newest - self._back[newest]
            slots[:, place] = newest
        slots %= self.capacity
        if len(self._gathered) != len(slots):
            self._gathered = np.empty(
                (len(slots), *self._observations.shape[1:], self.frame_stack), np.uint8)
        gather_stacks(self._observations, slots, self._gathered)
        return self._gathered.transpose(0, 3, 1, 2)

    @property
    def oldest(self) -> int:
        """Return the number of the oldest slot that is still held."""
        return max(self.written - self.capacity, 0)

    @property
    def observation_bytes(self) -> int:
        """Return the bytes of one observation."""
        return self._observations[0].nbytes

    def observations(self, first: int, end: int) -> np.ndarray:
        """Return a copy of slots first to end - 1, uint8 (end - first, H, W)."""
        return self._observations[np.arange(first, end) % self.capacity]

    def put_observations(self, first: int, observations: np.ndarray) -> None:
        """
        Put observations, uint8 (N, H, W), into the slots from `first` on that are still held.

        Raises:
            ValueError: another observation size or type.
        """
        own = self._observations
        if observations.shape[1:] != own.shape[1:] or observations.dtype != own.dtype:
            raise ValueError(f'replay observations are {observations.dtype} {observations.shape}; '
                             f'expected {own.dtype} {own.shape[1:]}')
        numbers = np.arange(first, first + len(observations))
        held = (numbers >= self.oldest) & (numbers < self.written)
        own[numbers[held] % self.capacity] = observations[held]

    def state_arrays(self) -> dict[str, np.ndarray]:
        """Return the filled part of each array but the observations, as views."""
        names = self._ARRAYS + self._OF_SEVERAL * bool(self._sources[:len(self)].any())
        return {name: getattr(self, f'_{name}')[:len(self)] for name in names}

    def load_state(self, arrays: dict[str, np.ndarray], written: int) -> None:
        """
        Take over what `state_arrays` gave; the observations are put in with `put_observations`.

        Raises:
            ValueError: arrays of another capacity.
        """
        size = min(written, self.capacity)
        for name in (*self._ARRAYS, *(name for name in self._OF_SEVERAL if name in arrays)):
            own = getattr(self, f'_{name}')
            if arrays[name].shape != (size, *own.shape[1:]) or arrays[name].dtype != own.dtype:
                raise ValueError(f'replay {name} are {arrays[name].dtype} {arrays[name].shape}; '
                                 f'expected {own.dtype} {(size, *own.shape[1:])}')
            own[:size] = arrays[name]
        self.written = written
        self._link()

    def _link(self) -> None:
        """Find the neighbours in each segment: a source has written them in their order."""
        numbers = np.arange(self.oldest, self.written)
        numbers = numbers[np.argsort(self._sources[numbers % self.capacity], kind='stable')]
        slots = numbers % self.capacity
        sources = self._sources[slots]
        same = sources[1:] == sources[:-1]
        distances = np.diff(numbers)
        self._ahead[slots[:-1]] = distances * same
        # what lay before the first of a source is overwritten, beyond the oldest
        back = numbers - self.oldest + 1
        back[1:][same] = distances[same]
        self._back[slots] = back * (self._ages[slots] > 0)
        self._newest = dict(zip(sources.tolist(), numbers.tolist()))


def make_replay(settings: Hyperparameters, capacity: int) -> ReplayBuffer:
    """
    Return an empty buffer for the model and the returns of a run.

    Raises:
        LearningError: there is no memory for it.
    """
    description = settings.model_description()
    space = description.action_space
    try:
        return ReplayBuffer(
            capacity, description.preprocessing.shape, frame_stack=settings.frame_stack,
            n_steps=settings.n_steps, gamma=settings.gamma, action_dtype=space.dtype,
            action_shape=space.shape)
    except MemoryError:
        height, width = description.preprocessing.shape
        raise LearningError(
            f'a replay of {capacity} observations of {width}x{height} takes '
            f'{capacity * height * width / 2**30:.0f} GiB, which this machine does not give; set '
            'replay_capacity lower, or shrink higher') from None


def sample_both(
    replay: ReplayBuffer, demonstrations: ReplayBuffer, batch_size: int, demonstrated: int,
    random: np.random.Generator,
) -> Batch:
    """
    Draw a batch that begins with so many demonstrated transitions.

    Raises:
        ValueError: one that is drawn from holds no transition.
    """
    parts = [buffer.sample(count, random) for buffer, count in (
        (demonstrations, demonstrated), (replay, batch_size - demonstrated)) if count]
    if len(parts) == 1:
        return parts[0]._replace(demonstrated=demonstrated)
    # keeps the channels last in memory, as both parts have them
    return Batch(*map(np.concatenate, list(zip(*parts))[:5]), demonstrated)
