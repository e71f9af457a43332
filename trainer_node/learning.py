# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Learning: transitions into the replay buffer, and the updates that are due.

What is learned is a function of the transitions in their order, and of the share of the run that
is done where the learning rate falls by it; never of the machine's speed.
"""
from __future__ import annotations

from collections import Counter, deque
import dataclasses
import math
from typing import Any

import numpy as np
import torch

from dqn_policy_node.model_folder import Model
from dqn_policy_node.preprocessing import Preprocessor
from msgs_bridge.errors import MessageError
from msgs_bridge.transitions import Transition
from trainer_node import schedules
from trainer_node.errors import LearningError
from trainer_node.hyperparameters import Hyperparameters
from trainer_node.learner import make_learner
from trainer_node.limiter import LimiterState, ReplayRatioLimiter
from trainer_node.replay_buffer import ReplayBuffer
from trainer_node.shaping import Shaping

MOVING_AVERAGE_EPISODES = 20
# of an error about how two models differ
MAX_TEXT = 300


@dataclasses.dataclass(frozen=True)
class LearningState:
    """What `Learning` is, apart from its arrays; see its attributes."""

    episodes: int
    decisions: int
    taken: int
    left_out: dict[str, int]
    segment_end: int | None
    written: int
    updates: int
    limiter: LimiterState
    learning_rate: schedules.LearningRateState
    returns: list[float]
    random: dict[str, Any]
    learner_random: dict[str, Any]


class Learning:
    """
    Replay, learner, limiter and schedules of one run.

    Call `insert` with a transition, `update` while one is `due`, and `end_episode` if the
    transition ended one.

    Attributes:
        State: what `state` returns.
        settings: the hyperparameters.
        description: the model that is learned.
        replay, learner, limiter: the parts.
        episodes, decisions: episodes that ended, transitions that were inserted.
        taken: transitions that came, with those that were left out.
        left_out: why transitions were left out: `foreign_actions`, `foreign_frames`, `bad_steps`.
        returns: of the last episodes.
    """

    State = LearningState

    def __init__(self, settings: Hyperparameters, device: str = 'auto') -> None:
        """Begin with an empty buffer and random weights; raises LearningError."""
        torch.set_num_threads(1)
        torch.manual_seed(settings.seed)
        self.settings = settings
        self.description = settings.model_description()
        space = self.description.action_space
        self._random = np.random.default_rng(settings.seed)
        self._preprocess = Preprocessor(self.description.preprocessing)
        self._shaping = Shaping(settings)
        self.learner = make_learner(settings, device)
        self.replay = ReplayBuffer(
            settings.replay_capacity, self.description.preprocessing.shape,
            frame_stack=settings.frame_stack, n_steps=settings.n_steps, gamma=settings.gamma,
            action_dtype=space.dtype, action_shape=space.shape,
            mirror=space.mirror if settings.flips else None)
        self.limiter = ReplayRatioLimiter(
            settings.samples_per_transition, settings.batch_size, settings.learning_starts)
        self._learning_rate = schedules.LearningRate(settings)
        self.episodes = self.decisions = self.taken = 0
        self.left_out: Counter[str] = Counter()
        # stamp of the observation that the next transition of the same segment begins with
        self._segment_end: int | None = None
        self.returns: deque[float] = deque(maxlen=MOVING_AVERAGE_EPISODES)

    def insert(self, transition: Transition) -> None:
        """
        Take the next transition into the replay buffer.

        Raises:
            LearningError: its steps lack what a shaping term needs.
            MessageError: the command is no action of the space, the frame has another size or the
                reward is not finite; the transition is left out.
        """
        self.taken += 1
        segment_end, self._segment_end = self._segment_end, None
        action = self._counted(
            'foreign_actions', self.description.action_space.encode, transition.command)
        next_observation = self._counted(
            'foreign_frames', self._preprocess, transition.next_frame)
        reward = self._counted('bad_steps', self._shaping.reward, transition)
        if transition.stamp != segment_end:
            self.replay.start(
                self._counted('foreign_frames', self._preprocess, transition.frame))
        self.replay.add(
            action, reward, next_observation, terminated=self._shaping.terminated(transition))
        if not transition.step.ended:
            self._segment_end = transition.next_stamp
        self.decisions += 1
        self.limiter.insert()

    def _counted(self, why: str, function: Any, argument: Any) -> Any:
        """Return what a function gives; count a MessageError before it goes on."""
        try:
            return function(argument)
        except MessageError:
            self.left_out[why] += 1
            raise

    @property
    def due(self) -> bool:
        """Return whether an update is due."""
        return self.limiter.due()

    def update(self, progress: float) -> dict[str, float]:
        """
        Make one update and return the learner's figures.

        Args:
            progress: share of the run that is done, 0 to 1.

        Raises:
            LearningError: the loss is not finite.
        """
        self._learning_rate.progressed(progress)
        batch = self.replay.sample(self.settings.batch_size, self._random)
        figures = self.learner.update(batch, self._learning_rate.value)
        self.limiter.sampled()
        return figures

    def end_episode(self, episode_return: float) -> None:
        """Take note of the end of an episode."""
        self.episodes += 1
        self.returns.append(episode_return)
        self._learning_rate.episode_ended(episode_return)
        self.learner.episode_ended(self.episodes)

    def begin_with(self, model: Model) -> None:
        """
        Take over the weights of a model before the first update.

        Raises:
            LearningError: they are those of another network, input or action space.
        """
        needed = self.description.shapes
        if (model.description.shapes != needed
                or model.description.action_space != self.description.action_space):
            raise LearningError(
                'initial_model does not fit these hyperparameters: '
                + '; '.join(self.description.differences(model.description))[:MAX_TEXT])
        self.learner.begin_with(model.tensors)

    @property
    def epsilon(self) -> float:
        """Return the present share of random actions."""
        return schedules.epsilon(
            self.settings, episodes=self.episodes, decisions=self.decisions)

    @property
    def learning_rate(self) -> float:
        """Return the present learning rate."""
        return self._learning_rate.value

    def figures(self) -> dict[str, float]:
        """Return the figures of the moment, for displays."""
        values = {
            'episodes': self.episodes, 'decisions': self.decisions,
            'updates': self.learner.updates, 'learning_rate': self.learning_rate,
            'replay_size': len(self.replay), 'replay_ratio': self.limiter.ratio,
            'foreign_actions': 0, **self.left_out}
        if self.returns:
            values['last_return'] = self.returns[-1]
            values['mean_return'] = math.fsum(self.returns) / len(self.returns)
        return values

    def arrays(self) -> dict[str, np.ndarray]:
        """Return what a checkpoint holds in arrays, the observations apart."""
        return {
            **{f'replay.{name}': array for name, array in self.replay.state_arrays().items()},
            **{f'learner.{name}': tensor.contiguous().numpy()
               for name, tensor in self.learner.state_tensors().items()},
            'torch_random': torch.get_rng_state().numpy()}

    def state(self) -> LearningState:
        """Return the rest of it."""
        return LearningState(
            self.episodes, self.decisions, self.taken, dict(self.left_out), self._segment_end,
            self.replay.written, self.learner.updates, self.limiter.state(),
            self._learning_rate.state(), list(self.returns), self._random.bit_generator.state,
            self.learner.random_state)

    def restore(self, state: LearningState, arrays: dict[str, np.ndarray]) -> None:
        """Go on from a checkpoint; KeyError, ValueError, ... if it does not fit."""
        def of(what: str) -> dict[str, np.ndarray]:
            return {name.removeprefix(what): array for name, array in arrays.items()
                    if name.startswith(what)}

        self.learner.load_state(
            {name: torch.from_numpy(array) for name, array in of('learner.').items()},
            state.updates)
        self.replay.load_state(of('replay.'), state.written)
        self.episodes, self.decisions, self.taken = state.episodes, state.decisions, state.taken
        self.left_out = Counter(state.left_out)
        self._segment_end = state.segment_end
        self.limiter.restore(state.limiter)
        self._learning_rate.restore(state.learning_rate)
        self.returns.extend(state.returns)
        self._random.bit_generator.state = state.random
        self.learner.random_state = state.learner_random
        torch.set_rng_state(torch.from_numpy(arrays['torch_random']))
