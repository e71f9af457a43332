# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
A training run: transitions in, better weights out.

`add` takes transitions strictly in order and makes the updates that are due, so what is learned
is a function of the stream of transitions and not of the machine's speed. (The one exception is
asked for by name: a run with `run_minutes` lets its learning rate fall by the clock.)
"""
from __future__ import annotations

from collections import deque
from collections.abc import Callable
import dataclasses
import math
from pathlib import Path
import time
from typing import Any

import numpy as np
import torch

from dqn_policy_node.model_folder import Model, save_model
from dqn_policy_node.preprocessing import Preprocessor
from dqn_policy_node.weights_message import encode_weights
from msgs_bridge.atomic_write import write_text
from msgs_bridge.errors import BridgeError, MessageError
from msgs_bridge.settings import from_mapping
from msgs_bridge.step import Step, VALIDATION_FIELDS
from msgs_bridge.transitions import Transition
from trainer_node import schedules
from trainer_node.checkpoint_file import read_checkpoint, write_checkpoint
from trainer_node.errors import RunError
from trainer_node.hyperparameters import Hyperparameters, to_yaml
from trainer_node.learner import Learner, UpdateResult
from trainer_node.limiter import ReplayRatioLimiter
from trainer_node.observation_blocks import ObservationBlocks
from trainer_node.replay_buffer import ReplayBuffer
from trainer_node.run_folder import describe_machine, now, RunFolder
from trainer_node.shaping import shaped_reward
from trainer_node.tracking import Tracking

UPDATES_PER_ROW = 200
MOVING_AVERAGE_EPISODES = 20
# versions sent out for validation whose results have not come back
MAX_PENDING = 4


class _Mean:
    """Means of the figures of updates since the last look."""

    def __init__(self, sums: list[float] | None = None, count: int = 0) -> None:
        self.sums = sums or [0.0] * len(UpdateResult._fields)
        self.count = count

    def add(self, result: UpdateResult) -> None:
        self.sums = [total + value for total, value in zip(self.sums, result)]
        self.count += 1

    def take(self) -> dict[str, float | None]:
        means = {
            name: total / self.count if self.count else None
            for name, total in zip(UpdateResult._fields, self.sums)}
        self.__init__()
        return means


class Training:
    """
    One run: buffer, learner, schedules, tracking and checkpoints.

    Make one with `create` or `resume`. Feed it with `add`; when `weights_due`, publish
    `weights_message`; hand results of validations to `record_validation`; when `checkpoint_due`,
    `save`; at the end `finish`.

    Attributes:
        settings: the hyperparameters.
        description: the model that is learned.
        folder: paths of the run folder.
        episodes, decisions, version: training episodes that ended, transitions that came in,
            and the version of the weights that were handed out last.
    """

    def __init__(
        self, settings: Hyperparameters, folder: RunFolder, *, device: str,
        tensorboard: bool, clock: Callable[[], float],
    ) -> None:
        """Prepare a run from its first transition on; use `create` or `resume`."""
        torch.set_num_threads(1)
        torch.manual_seed(settings.seed)
        self.settings = settings
        self.description = settings.model_description()
        self.folder = folder
        self._random = np.random.default_rng(settings.seed)
        self._clock = clock
        self._started = clock()
        self._wall_before = 0.0
        self._preprocess = Preprocessor(self.description.preprocessing)
        self.learner = Learner(settings, device)
        self.buffer = ReplayBuffer(
            settings.replay_capacity, self.description.preprocessing.shape,
            frame_stack=settings.frame_stack, n_steps=settings.n_steps, gamma=settings.gamma,
            mirrored=self.description.action_space.mirror(
                np.arange(len(self.description.action_space))) if settings.flips else None)
        self._blocks = ObservationBlocks(folder.checkpoint.parent)
        self.limiter = ReplayRatioLimiter(
            settings.samples_per_transition, settings.batch_size, settings.learning_starts)
        self._learning_rate = schedules.LearningRate(settings)
        self.episodes = self.decisions = self.version = self.foreign_actions = 0
        self._next_stamp = -1
        self._published_updates = 0
        self._validate = False
        self._validation_decisions = 0
        self._validation_seconds = 0.0
        self._pending: dict[int, dict[str, torch.Tensor]] = {}
        self._best: dict[str, Any] = {}
        self._last_validation: dict[str, float] = {}
        self._new_validation: float | None = None
        self._returns: deque[float] = deque(maxlen=MOVING_AVERAGE_EPISODES)
        self._of_episode = _Mean()
        self._of_row = _Mean()
        self._last_result: dict[str, float | None] = {}
        self._row_seconds = 0.0
        self._updates_per_second = 0.0
        self._saved_seconds = 0.0
        self._finished = False
        self._record: dict[str, Any] = {}
        self._tracking = Tracking(folder, tensorboard=tensorboard)

    @classmethod
    def create(
        cls, settings: Hyperparameters, run_folder: Path | str, *, device: str = 'auto',
        tensorboard: bool = False, clock: Callable[[], float] = time.monotonic,
    ) -> Training:
        """
        Begin a run in a new folder.

        Args:
            settings: the hyperparameters.
            run_folder: where everything is written; made if it is not there.
            device: where to learn, 'auto' for the best there is.
            tensorboard: whether to write event files, too.
            clock: seconds that only go forward.

        Raises:
            RunError: the folder holds a run already or cannot be written.
            LearningError: the device is not there.
        """
        folder = RunFolder(run_folder)
        folder.create()
        training = cls(settings, folder, device=device, tensorboard=tensorboard, clock=clock)
        training._record = {
            'started': now(), 'seeds': {
                'training': settings.seed, 'validation': settings.validation_seed},
            'sessions': []}
        training._begin_session()
        write_text(folder.config, to_yaml(settings))
        return training

    @classmethod
    def resume(
        cls, run_folder: Path | str, settings: Hyperparameters | None = None, *,
        device: str = 'auto', tensorboard: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ) -> Training:
        """
        Go on from the last checkpoint of a run as if nothing had happened.

        Args:
            run_folder: the folder of the run.
            settings: other hyperparameters from here on; the model must stay the same.
            device: as for `create`.
            tensorboard: as for `create`.
            clock: as for `create`.

        Raises:
            RunError: no checkpoint, a damaged one, or one of another model; the text says what
                differs.
        """
        folder = RunFolder(run_folder)
        arrays, state = read_checkpoint(folder.checkpoint)
        try:
            saved = from_mapping(Hyperparameters, state['settings'])
        except (BridgeError, KeyError) as error:
            raise RunError(f'{folder.checkpoint}: {error}') from None
        if settings is None:
            settings = saved
        differences = settings.model_description().differences(saved.model_description())
        if settings.replay_capacity != saved.replay_capacity:
            differences.append(f'replay_capacity is {settings.replay_capacity}, not '
                               f'{saved.replay_capacity}')
        if bool(settings.weight_average) != bool(saved.weight_average):
            differences.append(f'weight_average is {settings.weight_average}, not '
                               f'{saved.weight_average}')
        if differences:
            raise RunError(
                f'{folder.path} cannot be resumed with these settings, because its checkpoint '
                'differs: ' + '; '.join(differences))
        training = cls(settings, folder, device=device, tensorboard=tensorboard, clock=clock)
        try:
            training._load(arrays, state)
        except (KeyError, ValueError, TypeError, RuntimeError) as error:
            if isinstance(error, RunError):
                raise
            raise RunError(f'{folder.checkpoint}: damaged checkpoint: {error}') from None
        training._record = folder.read_record()
        training._begin_session()
        if settings != saved:
            write_text(folder.config, to_yaml(settings))
        return training

    # Learning. ---------------------------------------------------------------------------------

    def add(self, transition: Transition) -> int:
        """
        Take the next transition and make the updates that are due.

        Returns:
            How many updates were made.

        Raises:
            LearningError: the loss is not finite.
            MessageError: the command is no action of the space, or the frame has another size; the
                transition is left out.
        """
        try:
            action = self.description.action_space.encode(transition.command)
        except MessageError:
            self.foreign_actions += 1
            self._next_stamp = -1
            raise
        next_observation = self._preprocess(transition.next_frame)
        if transition.stamp != self._next_stamp:
            self.buffer.start(self._preprocess(transition.frame))
        step = transition.step
        reward = shaped_reward(self.settings, step, transition.previous)
        terminated = transition.terminated or bool(
            self.settings.early_end_terminal and step.info.get('ended_early'))
        self.buffer.add(action, reward, next_observation, terminated=terminated)
        ended = step.ended
        self._next_stamp = -1 if ended else transition.next_stamp
        self.decisions += 1
        self.limiter.insert()
        before = self.learner.updates
        while self.limiter.due():
            self._update()
        if ended:
            self._end_episode(step)
        self._look_at_validation(ended)
        return self.learner.updates - before

    def _update(self) -> None:
        self._learning_rate.progressed(self.progress)
        batch = self.buffer.sample(self.settings.batch_size, self._random)
        result = self.learner.update(batch, self._learning_rate.value)
        self.limiter.sampled()
        self._of_episode.add(result)
        self._of_row.add(result)
        if self.learner.updates % UPDATES_PER_ROW == 0:
            self._write_updates()

    def _write_updates(self) -> None:
        seconds = self.wall_seconds
        rows = self._of_row.count
        self._updates_per_second = rows / max(seconds - self._row_seconds, 1e-9)
        self._row_seconds = seconds
        means = self._of_row.take()
        self._last_result = means
        self._tracking.updated({
            'updates': self.learner.updates, 'decisions': self.decisions, **means,
            'grad_norm': means['gradient_norm'], 'learning_rate': self._learning_rate.value,
            'epsilon': self.epsilon, 'wall_seconds': seconds,
            'updates_per_second': self._updates_per_second})

    def _end_episode(self, step: Step) -> None:
        epsilon = self.epsilon
        self.episodes += 1
        reward, info = step.episode_return, step.info
        self._returns.append(reward)
        self._learning_rate.episode_ended(reward)
        if (self.settings.target_update == 'episodes'
                and self.episodes % self.settings.target_every == 0):
            self.learner.copy_to_target()
        means = self._of_episode.take()
        self._tracking.episode({
            'episode': self.episodes - 1, 'train_reward': reward,
            'validation_reward': self._new_validation, 'epsilon': epsilon,
            'learning_rate': self._learning_rate.value, 'frames': info.get('step'),
            'decisions': self.decisions, 'lap_finished': info.get('lap_finished'),
            'ended_early': info.get('ended_early'), 'tiles_visited': info.get('tiles_visited'),
            'tiles_total': info.get('tiles_total'),
            'standing_still': info.get('standing_still'),
            **means, 'updates': self.learner.updates, 'replay_size': len(self.buffer),
            'replay_ratio': self.limiter.ratio, 'weights_version': self.version,
            'wall_seconds': self.wall_seconds})
        self._new_validation = None

    @property
    def epsilon(self) -> float:
        """Return the present share of random actions."""
        return schedules.epsilon(
            self.settings, episodes=self.episodes, decisions=self.decisions)

    @property
    def learning_rate(self) -> float:
        """Return the present learning rate."""
        return self._learning_rate.value

    @property
    def wall_seconds(self) -> float:
        """Return the seconds this run has taken so far, over all its sessions."""
        return self._wall_before + self._clock() - self._started

    @property
    def progress(self) -> float:
        """Return the share of the run that is done, 0 to 1, by the limit that is nearest."""
        settings = self.settings
        shares = [
            done / limit for done, limit in (
                (self.decisions, settings.run_decisions),
                (self.episodes, settings.run_episodes),
                (self.wall_seconds, settings.run_minutes * 60)) if limit]
        return min(max(shares, default=0.0), 1.0)

    @property
    def complete(self) -> bool:
        """Return whether one of the limits of the run is reached."""
        return self.progress >= 1

    # Weights out, validations in. --------------------------------------------------------------

    def weights_due(self) -> bool:
        """Return whether weights should be published now."""
        return (self.version == 0 or self._validate
                or self.learner.updates - self._published_updates >= self.settings.weights_every)

    def weights_message(self, *, validate: bool | None = None) -> bytes:
        """
        Return the next version of the weights for the `weights` topic.

        Args:
            validate: whether to ask for a validation of them; None leaves it to the schedule.
        """
        if validate is None:
            validate = self._validate
        self.version += 1
        self._published_updates = self.learner.updates
        tensors = self.learner.acting_tensors()
        if validate:
            self._validate = False
            self._pending[self.version] = tensors
            while len(self._pending) > MAX_PENDING:
                del self._pending[min(self._pending)]
        return encode_weights(
            tensors, self.description, version=self.version, epsilon=self.epsilon,
            gas_weight=self.settings.gas_weight,
            exploration_hold=self.settings.exploration_hold, validate=validate)

    def _look_at_validation(self, ended: bool) -> None:
        """Ask for a validation when enough has happened since the last one."""
        settings = self.settings
        due = bool(ended and settings.validation_every_episodes
                   and self.episodes % settings.validation_every_episodes == 0)
        every = settings.validation_every_decisions
        due |= bool(every and self.decisions - self._validation_decisions >= every)
        every = settings.validation_every_minutes * 60
        due |= bool(every and self.wall_seconds - self._validation_seconds >= every)
        if due:
            self._validate = True
            self._validation_decisions = self.decisions
            self._validation_seconds = self.wall_seconds

    def record_validation(self, values: dict[str, float]) -> bool:
        """
        Take the result of a validation; keep its weights if none were better.

        Args:
            values: `VALIDATION_FIELDS`; results of a version that was not asked for, or was
                answered already, are left out.

        Returns:
            Whether the best model was replaced.

        Raises:
            MessageError: a field is missing.
        """
        for name in VALIDATION_FIELDS:
            if name not in values or not math.isfinite(values[name]):
                raise MessageError(f'validation lacks {name!r} or it is not finite')
        tensors = self._pending.pop(int(values['version']), None)
        if tensors is None:
            return False
        row = {**values, 'episode': self.episodes, 'decisions': self.decisions,
               'updates': self.learner.updates, 'wall_seconds': self.wall_seconds}
        self._tracking.validated(row)
        self._last_validation = row
        self._new_validation = values['mean']
        score = values['mean'] - self.settings.validation_spread_weight * values['std']
        if self._best and score <= self._best['score']:
            return False
        self._best = {'score': score, **row}
        save_model(self.folder.best, Model(
            self.description, tensors, self._training_record(), int(values['version'])))
        return True

    def _training_record(self) -> dict[str, Any]:
        """Return how the present weights came about, for a model folder."""
        return {
            'episodes': self.episodes, 'decisions': self.decisions,
            'updates': self.learner.updates, 'wall_seconds': self.wall_seconds,
            'validation': self._last_validation, 'best_validation': self._best,
            'run': {key: value for key, value in self._record.items() if key != 'sessions'},
            'machine': describe_machine(),
            'hyperparameters': dataclasses.asdict(self.settings),
        }

    # Figures and files. ------------------------------------------------------------------------

    def status(self) -> dict[str, float]:
        """Return the figures of the moment, for diagnostics and displays."""
        values: dict[str, float] = {
            'episodes': self.episodes, 'decisions': self.decisions,
            'updates': self.learner.updates, 'updates_per_second': self._updates_per_second,
            'progress': self.progress, 'epsilon': self.epsilon,
            'learning_rate': self._learning_rate.value, 'replay_size': len(self.buffer),
            'replay_ratio': self.limiter.ratio, 'weights_version': self.version,
            'foreign_actions': self.foreign_actions, 'wall_seconds': self.wall_seconds,
        }
        values.update(
            (name, value) for name, value in self._last_result.items() if value is not None)
        if self._returns:
            values['last_return'] = self._returns[-1]
            values['mean_return'] = math.fsum(self._returns) / len(self._returns)
        if self._last_validation:
            values['validation_mean'] = self._last_validation['mean']
            values['best_validation'] = self._best['mean']
        return values

    def checkpoint_due(self) -> bool:
        """Return whether it is time to `save`."""
        every = self.settings.checkpoint_every_minutes * 60
        return bool(every) and self.wall_seconds - self._saved_seconds >= every

    def save(self) -> Path:
        """
        Write a checkpoint of everything, whole or not at all; return its path.

        Raises:
            OSError: the disk is full or the folder cannot be written; the checkpoint before
                stays whole.
        """
        self._saved_seconds = self.wall_seconds
        arrays = {f'replay.{name}': array for name, array in self.buffer.state_arrays().items()}
        arrays['observations'] = self._blocks.write(self.buffer)
        for name, tensor in self.learner.state_tensors().items():
            arrays[f'learner.{name}'] = tensor.contiguous().numpy()
        for version, tensors in self._pending.items():
            for name, tensor in tensors.items():
                arrays[f'pending.{version}.{name}'] = tensor.contiguous().numpy()
        arrays['torch_random'] = torch.get_rng_state().numpy()
        state = {
            'settings': dataclasses.asdict(self.settings),
            'counters': {name: getattr(self, name) for name in self._COUNTERS},
            'updates': self.learner.updates,
            'written': self.buffer.written,
            'limiter': [self.limiter.transitions, self.limiter.updates],
            'learning_rate': [
                self._learning_rate.value, self._learning_rate.best_reward,
                self._learning_rate.episodes_without_better],
            'random': self._random.bit_generator.state,
            'learner_random': self.learner.random_state,
            'returns': list(self._returns),
            'of_episode': [self._of_episode.sums, self._of_episode.count],
            'of_row': [self._of_row.sums, self._of_row.count],
            'wall_seconds': self.wall_seconds,
            'positions': self._tracking.positions(),
        }
        write_checkpoint(self.folder.checkpoint, arrays, state)
        self._blocks.remove_unneeded(self.buffer)
        self._write_record()
        return self.folder.checkpoint

    _COUNTERS = (
        'episodes', 'decisions', 'version', 'foreign_actions', '_next_stamp',
        '_published_updates', '_validate', '_validation_decisions', '_validation_seconds',
        '_best', '_last_validation', '_new_validation', '_last_result', '_row_seconds',
        '_updates_per_second', '_saved_seconds')

    def _load(self, arrays: dict[str, np.ndarray], state: dict[str, Any]) -> None:
        """Take over a checkpoint; raises KeyError, ValueError or RunError if it is damaged."""
        tensors = {
            name: torch.from_numpy(array) for name, array in arrays.items()
            if name.startswith(('learner.', 'pending.', 'torch_random'))}
        self.learner.load_state(
            {name.removeprefix('learner.'): tensor for name, tensor in tensors.items()},
            state['updates'])
        self.buffer.load_state(
            {name.removeprefix('replay.'): array for name, array in arrays.items()},
            state['written'])
        self._blocks.read(self.buffer, arrays['observations'])
        for name, tensor in tensors.items():
            if name.startswith('pending.'):
                _, version, key = name.split('.', 2)
                self._pending.setdefault(int(version), {})[key] = tensor
        for name in self._COUNTERS:
            setattr(self, name, state['counters'][name])
        self.limiter.transitions, self.limiter.updates = state['limiter']
        (self._learning_rate.value, self._learning_rate.best_reward,
         self._learning_rate.episodes_without_better) = state['learning_rate']
        self._random.bit_generator.state = state['random']
        self.learner.random_state = state['learner_random']
        self._returns.extend(state['returns'])
        self._of_episode = _Mean(*state['of_episode'])
        self._of_row = _Mean(*state['of_row'])
        self._wall_before = state['wall_seconds']
        self._tracking.set_back(state['positions'])
        torch.set_rng_state(tensors['torch_random'])

    def finish(self) -> Path:
        """
        Write checkpoint and final model, and close the files; return the model's folder.

        Raises:
            OSError: the disk is full or the folder cannot be written.
        """
        if self._finished:
            return self.folder.final
        self.save()
        save_model(self.folder.final, Model(
            self.description, self.learner.acting_tensors(), self._training_record(),
            self.version))
        self._tracking.close()
        self._finished = True
        return self.folder.final

    def _begin_session(self) -> None:
        """Note in `run.json` when and on what machine this part of the run began."""
        self._record.setdefault('sessions', []).append({
            'started': now(), 'from_seconds': self._wall_before,
            'device': str(self.learner.device), **describe_machine()})
        self._write_record()

    def _write_record(self) -> None:
        self._record['wall_seconds'] = self.wall_seconds
        self._record['complete'] = self.complete
        self.folder.write_record(self._record)
