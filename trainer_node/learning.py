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
from weakref import WeakValueDictionary

import numpy as np
import torch

from dqn_policy_node.model_folder import Model
from dqn_policy_node.preprocessing import Preprocessor
from msgs_bridge.errors import MessageError
from msgs_bridge.transitions import Transition
from trainer_node import schedules
from trainer_node.augmentation import augment
from trainer_node.demonstrations import Demonstrations
from trainer_node.errors import LearningError
from trainer_node.hyperparameters import Hyperparameters
from trainer_node.learner import make_learner
from trainer_node.limiter import LimiterState, ReplayRatioLimiter
from trainer_node.replay_buffer import Batch, make_replay, ReplayBuffer, sample_both
from trainer_node.saved_state import Stamp
from trainer_node.settings import MOVING_AVERAGE_EPISODES
from trainer_node.shaping import Shaping

# of an error about how two models differ
MAX_TEXT = 300
MAX_SOURCES = 4096
"""Sources with a name that a run remembers, whether they are there or not."""


@dataclasses.dataclass
class SourceState:
    """
    What is remembered of a named source, one of several, from session to session.

    Attributes:
        number: what it is called in the replay, from 1.
        segment_end: stamp in ns of the observation that its next transition of the same segment
            begins with; None if that begins another.
        episodes, decisions: episodes of it that ended, transitions of it that were inserted.
        last_return: of its last episode; None before the first.
        left_out: why transitions of it were left out, as in `Learning`.
    """

    number: int
    segment_end: Stamp | None = None
    episodes: int = 0
    decisions: int = 0
    last_return: float | None = None
    left_out: dict[str, int] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class LearningState:
    """What `Learning` is, apart from its arrays; see its attributes."""

    episodes: int
    decisions: int
    taken: int
    left_out: dict[str, int]
    segment_end: Stamp | None
    written: int
    updates: int
    limiter: LimiterState
    learning_rate: schedules.LearningRateState
    returns: list[float]
    random: dict[str, Any]
    learner_random: dict[str, Any]
    sources: dict[str, SourceState] = dataclasses.field(default_factory=dict)
    demonstrations: str = ''


class Learning:
    """
    Replay, learner, limiter and schedules of one run.

    Call `insert` with a transition, `update` while one is `due`, and `end_episode` if the
    transition ended one.

    Attributes:
        State: what `state` returns.
        settings: the hyperparameters.
        description: the model that is learned.
        demonstrations: what a part of each batch is drawn from; None without any.
        replay, learner, limiter: the parts.
        episodes, decisions: episodes that ended, transitions that were inserted.
        taken: transitions that came, with those that were left out.
        left_out: why transitions were left out: `foreign_actions`, `foreign_frames`, `bad_steps`.
        returns: of the last episodes.
        sources: what is remembered of each source that has a name, when there are several.
    """

    State = LearningState

    def __init__(
        self, settings: Hyperparameters, device: str = 'auto',
        demonstrations: Demonstrations | None = None,
    ) -> None:
        """Begin with an empty buffer and random weights; raises LearningError."""
        torch.set_num_threads(1)
        torch.manual_seed(settings.seed)
        self.settings, self.demonstrations = settings, demonstrations
        self.description = settings.model_description()
        self._random = np.random.default_rng(settings.seed)
        self._preprocess = Preprocessor(self.description.preprocessing)
        self._shaping = Shaping(settings)
        self.learner = make_learner(settings, device)
        self.replay, self.limiter = self._empty_replay()
        self._learning_rate = schedules.LearningRate(settings)
        self.episodes = self.decisions = self.taken = 0
        self.left_out: Counter[str] = Counter()
        # of the one source without a name
        self._only = SourceState(0)
        self.sources: dict[str, SourceState] = {}
        self.returns: deque[float] = deque(maxlen=MOVING_AVERAGE_EPISODES)
        # what the segment of a source ended with, by its number, while its next transition has it
        self._last_frames: WeakValueDictionary[int, np.ndarray] = WeakValueDictionary()

    def _empty_replay(self) -> tuple[ReplayBuffer, ReplayRatioLimiter]:
        settings = self.settings
        return make_replay(settings, settings.replay_capacity), ReplayRatioLimiter(
            settings.samples_per_transition, settings.batch_size, settings.learning_starts)

    def forget_replay(self) -> None:
        """Empty the replay; updates go on once `learning_starts` transitions have come in."""
        self.replay, self.limiter = self._empty_replay()
        for of in (self._only, *self.sources.values()):
            of.segment_end = None

    def insert(self, transition: Transition, source: str = '') -> bool:
        """
        Take the next transition into the replay buffer.

        Args:
            transition: in the order of its source.
            source: whose it is, if there are several.

        Returns:
            Whether it goes on where the one before of its source ended.

        Raises:
            LearningError: its steps lack what a shaping term needs, and it is the one source.
            MessageError: the command is no action of the space, the frame has another size, the
                reward is not finite, or one of several sources lacks what a shaping term needs;
                the transition is left out.
        """
        self.taken += 1
        of = self.source(source) if source else self._only
        segment_end, of.segment_end = of.segment_end, None
        action = self._counted(
            of, 'foreign_actions', self.description.action_space.encode, transition.command)
        next_observation = self._counted(
            of, 'foreign_frames', self._preprocess, transition.next_frame)
        reward = self._counted(of, 'bad_steps', self._shaping.reward, transition)
        goes_on = transition.stamp == segment_end and self._goes_on(of, transition.frame)
        if not goes_on or not self.replay.can_add(of.number):
            self.replay.start(
                self._counted(of, 'foreign_frames', self._preprocess, transition.frame),
                of.number)
        self.replay.add(
            action, reward, next_observation, terminated=self._shaping.terminated(transition),
            source=of.number)
        self._last_frames.pop(of.number, None)
        if not transition.step.ended:
            of.segment_end = transition.next_stamp
            self._last_frames[of.number] = transition.next_frame
        self.decisions += 1
        of.decisions += 1
        self.limiter.insert()
        return goes_on

    def _goes_on(self, of: SourceState, frame: np.ndarray) -> bool:
        """
        Return whether a source has ended its segment with a frame.

        The stamp alone does not say so: a simulator that is started again uses its stamps again.
        """
        return frame is self._last_frames.get(of.number) or (
            self.replay.can_add(of.number) and np.array_equal(
                self._counted(of, 'foreign_frames', self._preprocess, frame),
                self.replay.newest(of.number)))

    def source(self, name: str) -> SourceState:
        """
        Return what is remembered of a source with a name, from now on if it is new.

        Raises:
            MessageError: there have been too many.
        """
        found = self.sources.get(name)
        if found is None:
            if len(self.sources) == MAX_SOURCES:
                raise MessageError(f'{name}: {MAX_SOURCES} sources have been there before it')
            found = self.sources[name] = SourceState(len(self.sources) + 1)
        return found

    def _counted(self, of: SourceState, why: str, function: Any, argument: Any) -> Any:
        """Return what a function gives; count a MessageError before it goes on."""
        try:
            return function(argument)
        except (MessageError, LearningError) as error:
            if isinstance(error, LearningError) and of is self._only:
                raise
            self.left_out[why] += 1
            of.left_out[why] = of.left_out.get(why, 0) + 1
            # one of several does not end the learning from the others
            raise MessageError(str(error)) from None

    @property
    def pretraining(self) -> bool:
        """Return whether updates from demonstrations alone are due, before anything is driven."""
        return (self.demonstrations is not None
                and self.learner.updates < self.settings.demonstration_updates)

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
        pretraining = self.pretraining
        batch = augment(self._sample(pretraining), self.settings, self._random)
        figures = self.learner.update(batch, self._learning_rate.value)
        if not pretraining:
            self.limiter.sampled()
        return figures

    def _sample(self, pretraining: bool) -> Batch:
        size = self.settings.batch_size
        if self.demonstrations is None:
            return self.replay.sample(size, self._random)
        share = 1.0 if pretraining else self.settings.demonstration_share
        return sample_both(self.replay, self.demonstrations.replay, size, round(share * size),
                           self._random)

    def end_episode(self, episode_return: float, source: str = '') -> None:
        """Take note of the end of an episode of a source."""
        if source:
            of = self.sources[source]
            of.episodes += 1
            of.last_return = episode_return
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
            self.episodes, self.decisions, self.taken, dict(self.left_out),
            self._only.segment_end,
            self.replay.written, self.learner.updates, self.limiter.state(),
            self._learning_rate.state(), list(self.returns), self._random.bit_generator.state,
            self.learner.random_state, self.sources,
            self.demonstrations.sha256 if self.demonstrations else '')

    def restore(self, state: LearningState, arrays: dict[str, np.ndarray]) -> None:
        """Go on from a checkpoint; KeyError, ValueError, ... if it does not fit."""
        def of(what: str) -> dict[str, np.ndarray]:
            return {name.removeprefix(what): array for name, array in arrays.items()
                    if name.startswith(what)}

        if state.demonstrations != (self.demonstrations.sha256 if self.demonstrations else ''):
            raise ValueError('its demonstrations are others than the run began with')
        self.learner.load_state(
            {name: torch.from_numpy(array) for name, array in of('learner.').items()},
            state.updates)
        self.replay.load_state(of('replay.'), state.written)
        self.episodes, self.decisions, self.taken = state.episodes, state.decisions, state.taken
        self.left_out = Counter(state.left_out)
        self._only.segment_end = state.segment_end
        self.sources = {name: dataclasses.replace(of) for name, of in state.sources.items()}
        if sorted(of.number for of in self.sources.values()) != [
                *range(1, len(self.sources) + 1)] or len(self.sources) > MAX_SOURCES:
            raise ValueError('its sources are not numbered from 1')
        self.limiter.restore(state.limiter)
        self._learning_rate.restore(state.learning_rate)
        self.returns.extend(state.returns)
        self._random.bit_generator.state = state.random
        self.learner.random_state = state.learner_random
        torch.set_rng_state(torch.from_numpy(arrays['torch_random']))
