# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
The replay buffer: every observation once, samples by a few vectorised reads.

Observations lie in a ring in the order they came. A slot holds an observation and, once it is
known, what was done on seeing it: action, reward and whether the rules ended the episode there.
The last observation of a trajectory segment has no action, so whatever walks forward from a slot
stops there, and `age`, the number of observations before it in its segment, stops whatever looks
back.
"""
from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

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
    """

    observations: np.ndarray
    actions: np.ndarray
    rewards: np.ndarray
    next_observations: np.ndarray
    discounts: np.ndarray


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
        mirror: exchanges left and right in encoded actions, to flip half of the samples; None
            never does.
    """

    _ARRAYS = ('actions', 'rewards', 'terminated', 'acted', 'ages')

    def __init__(
        self, capacity: int, shape: tuple[int, int], *, frame_stack: int = 1, n_steps: int = 1,
        gamma: float = 0.99, action_dtype: np.dtype | type = np.uint8,
        action_shape: tuple[int, ...] = (),
        mirror: Callable[[np.ndarray], np.ndarray] | None = None,
    ) -> None:
        """Reserve the memory; pages are taken as they are filled."""
        self.capacity = capacity
        self.frame_stack = frame_stack
        self.n_steps = n_steps
        self.gamma = gamma
        self._mirror = mirror
        self._observations = np.empty((capacity, *shape), np.uint8)
        self._actions = np.zeros((capacity, *action_shape), action_dtype)
        self._rewards = np.zeros(capacity, np.float32)
        self._terminated = np.zeros(capacity, bool)
        self._acted = np.zeros(capacity, bool)
        self._ages = np.zeros(capacity, np.int32)
        # slots ever written; slot number n lies at n % capacity
        self.written = 0
        self._gathered = np.empty((0, *shape, frame_stack), np.uint8)

    def __len__(self) -> int:
        """Return the number of observations held."""
        return min(self.written, self.capacity)

    @property
    def transitions(self) -> int:
        """Return the number of transitions held."""
        return int(np.count_nonzero(self._acted[:len(self)]))

    def start(self, observation: np.ndarray) -> None:
        """Begin a segment with its first observation, uint8 (H, W)."""
        self._write(observation, 0)

    def add(
        self, action: object, reward: float, next_observation: np.ndarray, *, terminated: bool,
    ) -> None:
        """
        Add what was done on seeing the newest observation, and the observation that followed.

        Args:
            action: the encoded action.
            reward: what it earned, shaped and scaled.
            next_observation: uint8 (H, W).
            terminated: whether the rules ended the episode. After any end call `start` next.
        """
        newest = (self.written - 1) % self.capacity
        self._actions[newest] = action
        self._rewards[newest] = reward
        self._terminated[newest] = terminated
        self._acted[newest] = True
        self._write(next_observation, int(self._ages[newest]) + 1)

    def _write(self, observation: np.ndarray, age: int) -> None:
        slot = self.written % self.capacity
        self._observations[slot] = observation
        self._ages[slot] = age
        self._acted[slot] = False
        self._terminated[slot] = False
        self.written += 1

    def sample(self, batch_size: int, random: np.random.Generator) -> Batch:
        """
        Draw transitions uniformly, with replacement.

        The observations are views on memory that the next call overwrites.

        Raises:
            ValueError: no transition is held.
        """
        numbers = self._draw(batch_size, random)
        rewards, discounts, steps = self._look_ahead(numbers)
        slots = numbers % self.capacity
        actions = self._actions[slots]
        observations = self._stacks(np.concatenate([numbers, numbers + steps]))
        if self._mirror is not None:
            flipped = random.random(batch_size) < 0.5
            actions[flipped] = self._mirror(actions[flipped])
            both = np.concatenate([flipped, flipped])
            observations[both] = observations[both][..., ::-1]
        return Batch(
            observations[:batch_size], actions, rewards, observations[batch_size:], discounts)

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
            wrong = np.flatnonzero(~self._acted[numbers % self.capacity])
            if not len(wrong):
                return numbers
            numbers[wrong] = random.integers(low, high, len(wrong))
        # hardly any slot holds an action: choose among those that do
        usable = np.arange(low, high)
        usable = usable[self._acted[usable % self.capacity]]
        if not len(usable):
            raise ValueError('the replay buffer holds no transition')
        return usable[random.integers(0, len(usable), count)]

    def _look_ahead(self, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return rewards over up to n steps, discounts after them, and how many there were."""
        rewards = np.zeros(len(numbers))
        discounts = np.ones(len(numbers))
        steps = np.zeros(len(numbers), np.int64)
        alive = np.ones(len(numbers), bool)
        ended = np.zeros(len(numbers), bool)
        for step in range(self.n_steps):
            slots = (numbers + step) % self.capacity
            alive = alive & self._acted[slots]
            rewards += np.where(alive, discounts * self._rewards[slots], 0.0)
            discounts = np.where(alive, discounts * self.gamma, discounts)
            ended |= alive & self._terminated[slots]
            steps += alive
        discounts[ended] = 0.0
        return rewards.astype(np.float32), discounts.astype(np.float32), steps

    def _stacks(self, numbers: np.ndarray) -> np.ndarray:
        """Return the stacks that end at slots, uint8 (N, stack, H, W), channels last."""
        back = np.arange(self.frame_stack - 1, -1, -1)
        ages = self._ages[numbers % self.capacity]
        slots = (numbers[:, None] - np.minimum(back, ages[:, None])) % self.capacity
        if len(self._gathered) != len(slots):
            self._gathered = np.empty(
                (len(slots), *self._observations.shape[1:], self.frame_stack), np.uint8)
        gather_stacks(self._observations, slots, self._gathered)
        return self._gathered.transpose(0, 3, 1, 2)

    @property
    def oldest(self) -> int:
        """Return the number of the oldest slot that is still held."""
        return max(self.written - self.capacity, 0)

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
        return {name: getattr(self, f'_{name}')[:len(self)] for name in self._ARRAYS}

    def load_state(self, arrays: dict[str, np.ndarray], written: int) -> None:
        """
        Take over what `state_arrays` gave; the observations are put in with `put_observations`.

        Raises:
            ValueError: arrays of another capacity.
        """
        size = min(written, self.capacity)
        for name in self._ARRAYS:
            own = getattr(self, f'_{name}')
            if arrays[name].shape != (size, *own.shape[1:]) or arrays[name].dtype != own.dtype:
                raise ValueError(f'replay {name} are {arrays[name].dtype} {arrays[name].shape}; '
                                 f'expected {own.dtype} {(size, *own.shape[1:])}')
            own[:size] = arrays[name]
        self.written = written
