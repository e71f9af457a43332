# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
A training run: learning, model selection, records and checkpoint put together.

`add` takes transitions strictly in order and makes the updates that are due, so what is learned
is a function of the stream of transitions and not of the machine's speed. (The one exception is
asked for by name: a run with `run_minutes` lets its learning rate fall by the clock.)

Who drives a run lets a `Driver` (`trainer_node/driver.py`) ask what is due when.
"""
from __future__ import annotations

from collections.abc import Callable, Mapping
import dataclasses
from pathlib import Path
import shutil
import time
from typing import Any
import uuid

from dqn_policy_node.errors import ModelError
from dqn_policy_node.model_description import ModelDescription
from dqn_policy_node.model_folder import load_model, Model, save_model
from dqn_policy_node.model_record import read_model_record
from dqn_policy_node.shipped_models import find_model
from dqn_policy_node.weights_message import AXES_SHARE, encode_weights
from msgs_bridge.errors import BridgeError, MessageError
from msgs_bridge.machine import describe_machine
from msgs_bridge.transitions import Transition
from trainer_node.checkpoint import Checkpoint, Part, refuse_differences
from trainer_node.demonstrations import read_demonstrations
from trainer_node.errors import LearningError, RunError
from trainer_node.hyperparameters import Hyperparameters, to_yaml
from trainer_node.learning import Learning
from trainer_node.model_selection import ModelSelection, Moment
from trainer_node.run_clock import RunClock
from trainer_node.run_folder import now, RunFolder
from trainer_node.run_record import RunRecord
from trainer_node.tuner import Tuner

# what of `run.json` says which recordings are learned from
SOURCE = 'source'
# sources whose episodes are told in the weights
MOST_TOLD = 256


class Training:
    """
    One run in its folder.

    Make one with `create` or `resume`, feed it with `add`, `finish` it at the end.

    Attributes:
        settings: the hyperparameters.
        folder: paths of the run folder.
        learning: replay, learner, limiter and schedules.
        selection: versions of the weights and the best of them.
        several: whether its sources have names; weights say then what a car needs to join.
        cars: how many of them are counted on.
        tuner: chooses between two action spaces; None without one.
    """

    def __init__(
        self, settings: Hyperparameters, folder: RunFolder, *, device: str,
        tensorboard: bool, clock: Callable[[], float],
    ) -> None:
        """Prepare a run from its first transition on; use `create` or `resume`."""
        self.settings = settings
        self.folder = folder
        self._clock = RunClock(clock)
        self.learning = Learning(settings, device, read_demonstrations(
            folder.path / settings.demonstrations, settings) if settings.demonstrations else None)
        self.selection = ModelSelection(settings)
        self.tuner = Tuner(settings) if settings.tuner_series else None
        self._record = RunRecord(
            folder, self.learning.learner.FIGURES, tensorboard=tensorboard)
        self._checkpoint = Checkpoint(folder.checkpoint)
        # so that a policy tells the weights of this start from those of another
        self._session = uuid.uuid4().hex
        self.several, self.cars = False, 0
        self._saved_seconds = 0.0
        self._finished = False
        self._failure: LearningError | None = None

    @classmethod
    def create(
        cls, settings: Hyperparameters, run_folder: Path | str, *, device: str = 'auto',
        tensorboard: bool = False, clock: Callable[[], float] = time.monotonic,
    ) -> Training:
        """
        Begin a run in a new folder, or in one whose run was killed before its first checkpoint.

        Args:
            settings: the hyperparameters.
            run_folder: where everything is written; made if it is not there.
            device: where to learn, 'auto' for the best there is.
            tensorboard: whether to write event files, too.
            clock: seconds that only go forward.

        Raises:
            RunError: the folder holds a run already or cannot be written.
            LearningError: the device is not there, or `initial_model` is another network.
            ModelError: there is no `initial_model`, or it is damaged.
        """
        folder = RunFolder(run_folder)
        new = not folder.path.exists()
        folder.create()
        folder.remove_leftovers()
        try:
            training = cls(settings, folder, device=device, tensorboard=tensorboard, clock=clock)
            if settings.initial_model:
                training.learning.begin_with(
                    load_model(find_model(settings.initial_model, folder.path)))
        except BridgeError:
            if new:
                shutil.rmtree(folder.path, ignore_errors=True)
            raise
        folder.write_config(to_yaml(settings))
        shown = training.learning.demonstrations
        training._begin_session({
            'started': now(), 'seeds': {
                'training': settings.seed, 'validation': settings.validation_seed},
            **({'demonstrations': dataclasses.asdict(shown.summary)} if shown else {})})
        # from its first moment on there is something to go on from
        training.save()
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
            settings: other hyperparameters from here on. They take effect with the next update;
                the model, the learner and what rewards are made of must stay the same.
            device: as for `create`.
            tensorboard: as for `create`.
            clock: as for `create`.

        Raises:
            RunError: no checkpoint, a damaged one, or one of another model; the text says what
                differs.
        """
        folder = RunFolder(run_folder)
        checkpoint = Checkpoint(folder.checkpoint)
        saved = checkpoint.read()
        settings = settings or saved.settings
        refuse_differences(settings, saved.settings, folder.path)
        folder.check_writable()
        folder.remove_leftovers()
        training = cls(settings, folder, device=device, tensorboard=tensorboard, clock=clock)
        training._checkpoint.restore(saved, training._parts, training.learning.replay)
        try:
            training.selection.best_is(
                read_model_record(folder.best).training.get('best_validation') or '')
        except ModelError:
            training.selection.best_is(None)
        training._saved_seconds = training.wall_seconds
        training._begin_session(folder.read_record())
        if settings != saved.settings:
            folder.write_config(to_yaml(settings))
        return training

    @property
    def _parts(self) -> dict[str, Part]:
        """Return what a checkpoint is made of, by name."""
        parts = {'learning': self.learning, 'selection': self.selection,
                 'record': self._record, 'clock': self._clock}
        return parts if self.tuner is None else {**parts, 'tuner': self.tuner}

    def _begin_session(self, run: dict[str, Any]) -> None:
        self._record.begin_session(
            run, device=self.learning.learner.device, seconds=self._clock.before)
        self._write_run()

    def _write_run(self) -> None:
        self._record.write_run(seconds=self.wall_seconds, complete=self.complete)

    @property
    def description(self) -> ModelDescription:
        """Return the model that is learned."""
        return self.learning.description

    @property
    def episodes(self) -> int:
        """Return how many training episodes have ended."""
        return self.learning.episodes

    @property
    def decisions(self) -> int:
        """Return how many transitions have come in."""
        return self.learning.decisions

    @property
    def version(self) -> int:
        """Return the version of the weights that were handed out last."""
        return self.selection.version

    @property
    def wall_seconds(self) -> float:
        """Return the seconds this run has taken so far, over all its sessions."""
        return self._clock.seconds

    @property
    def moment(self) -> Moment:
        """Return how far the run is, as records name it."""
        return Moment(
            self.episodes, self.decisions, self.learning.learner.updates, self.wall_seconds)

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
        """Return whether one of the limits of the run is reached, or it was finished."""
        return self._finished or self.progress >= 1

    @property
    def failed(self) -> bool:
        """Return whether learning has failed, so that the checkpoint before is kept."""
        return self._failure is not None

    @property
    def acting_epsilon(self) -> float:
        """Return the epsilon that is driven with: that of the weights that went out last."""
        handed_out = self.selection.epsilon
        return self.learning.epsilon if handed_out is None else handed_out

    def add(self, transition: Transition, source: str = '') -> int:
        """
        Take the next transition and make the updates that are due.

        Args:
            transition: in the order of its source.
            source: whose it is, if there are several.

        Returns:
            How many updates were made.

        Raises:
            LearningError: the loss is not finite, or a shaping term lacks what it needs.
            MessageError: the transition is left out, as `Learning.insert` says. If an episode
                ended with it, that has ended all the same.
        """
        learning, updates = self.learning, self.learning.learner.updates
        left_out: MessageError | None = None
        try:
            goes_on = learning.insert(transition, source)
            if self.tuner is not None:
                self.tuner.took(transition.command, source, goes_on=goes_on)
            while learning.due:
                self._update()
        except MessageError as error:
            left_out = error
        except LearningError as error:
            self._failure = error
            raise
        # nothing is remembered of a source for which there was no room
        ended = transition.step.ended and (not source or source in learning.sources)
        if ended:
            epsilon = self.acting_epsilon
            learning.end_episode(transition.step.episode_return, source)
            if self.tuner is not None and self.tuner.episode_ended(
                    self.episodes, transition.step.episode_return, source):
                self._record.note('tuner', self.tuner.to_json())
            self._record.episode(
                transition.step, learning, epsilon=epsilon, version=self.version,
                seconds=self.wall_seconds, source=source)
        self.selection.ask_when_due(self.moment, episode_ended=ended)
        if left_out is not None:
            raise left_out
        return learning.learner.updates - updates

    @property
    def pretraining(self) -> bool:
        """Return whether updates from demonstrations are due, before anything is driven."""
        return self.learning.pretraining

    def pretrain(self) -> None:
        """Make one update from demonstrations; raises LearningError as `add`."""
        try:
            self._update()
        except LearningError as error:
            self._failure = error
            raise

    def _update(self) -> None:
        learning = self.learning
        self._record.updated(
            learning.update(self.progress), learning, epsilon=learning.epsilon,
            seconds=self.wall_seconds)

    def weights_due(self) -> bool:
        """Return whether weights should be published now."""
        return self.selection.due(self.learning.learner.updates, self.learning.epsilon)

    def next_weights(self, *, validate: bool | None = None) -> bytes:
        """
        Make the next version of the weights; return it for the `weights` topic.

        Args:
            validate: whether to ask for a validation of them; None leaves it to the schedule.
        """
        tensors, epsilon = self.learning.learner.acting_tensors(), self.learning.epsilon
        validate = self.selection.next_version(
            tensors, self.moment, epsilon, validate=validate)
        return encode_weights(
            tensors, self.description, version=self.version, epsilon=epsilon,
            gas_weight=self.settings.gas_weight,
            exploration_hold=self.settings.exploration_hold, validate=validate,
            session=self._session, extra=self._extra())

    def _extra(self) -> dict[str, Any]:
        """Return what goes out with the weights beside how to act with them."""
        return {**(self.tuner.extra() if self.tuner is not None else {}),
                **(self._for_cars() if self.several else {})}

    def _for_cars(self) -> dict[str, Any]:
        """Return what a car needs to know that joins: how to drive, and what it has behind it."""
        sources = list(self.learning.sources.items())[-MOST_TOLD:]
        return {'seed': self.settings.seed, 'simulator': self.settings.simulator_parameters(),
                'cars': max(self.cars, len(sources)), 'spread': self.settings.epsilon_spread,
                'episodes': {name: of.episodes for name, of in sources}}

    def record_validation(self, values: Mapping[str, float]) -> bool:
        """
        Take the result of a validation; keep its weights if none were better.

        Args:
            values: `step.VALIDATION_FIELDS`; results of a version that was not asked for, or was
                answered already, are left out.

        Returns:
            Whether the best model was replaced.

        Raises:
            MessageError: a field is missing.
            RunError: the model cannot be written.
        """
        judgement = self.selection.judge(values)
        if judgement is None:
            return False
        self._record.validated(judgement.row)
        if judgement.better:
            row = judgement.row
            self._save_model(self.folder.best, judgement.tensors, int(row['version']), Moment(
                **{field.name: row[field.name] for field in dataclasses.fields(Moment)}))
        return judgement.better

    def _save_model(
        self, folder: Path, tensors: dict[str, Any], version: int, made: Moment,
    ) -> None:
        """Write a model folder whose record says when its weights were made."""
        moment = dataclasses.asdict(made)
        try:
            save_model(folder, Model(self.description, tensors, {
                'episodes': moment.pop('episode'), **moment,
                'validation': self.selection.last, 'best_validation': self.selection.best,
                'run': self._record.run, 'machine': describe_machine(),
                'hyperparameters': dataclasses.asdict(self.settings)}, version))
        except OSError as error:
            raise RunError(f'{folder} cannot be written: {error.strerror}') from None

    def status(self) -> dict[str, float]:
        """Return the figures of the moment, for diagnostics and displays."""
        values: dict[str, float] = {
            **self.learning.figures(), **self._record.figures(), 'progress': self.progress,
            'epsilon': self.learning.epsilon, 'weights_version': self.version,
            'wall_seconds': self.wall_seconds}
        if self.tuner is not None:
            values[AXES_SHARE] = self.tuner.share
        if self.selection.last:
            values['validation_mean'] = self.selection.last['mean']
        if self.selection.best:
            values['best_validation'] = self.selection.best['mean']
        return values

    def learns_from(self, names: list[str], limit: int | None = None) -> int:
        """
        Begin or go on with a recorded source of transitions.

        Args:
            names: of what is read, in order.
            limit: `run_decisions`, if it comes from how much there is; None if it does not.

        Returns:
            How many of its first transitions the run has taken before.
        """
        found = self._record.noted(SOURCE)
        first = found.get('first') if isinstance(found, dict) else None
        if type(first) is not int or not 0 <= first <= self.learning.taken or (
                found.get('names') != names):
            found = {'names': names, 'first': self.learning.taken, 'run_decisions': limit}
            self._record.note(SOURCE, found)
            self._write_run()
        return self.learning.taken - found['first']

    def checkpoint_due(self) -> bool:
        """Return whether it is time to `save`."""
        every = self.settings.checkpoint_every_minutes * 60
        return bool(every) and self.wall_seconds - self._saved_seconds >= every

    def save(self) -> Path:
        """
        Write a checkpoint of everything, whole or not at all; return its path.

        Raises:
            RunError: the disk is full or the folder cannot be written, or learning has failed,
                so that going on from here would fail again; the checkpoint before stays whole.
        """
        if self._failure is not None:
            raise RunError(
                f'learning has failed, so the checkpoint before is kept: {self.folder.checkpoint}')
        self._saved_seconds = self.wall_seconds
        path = self._checkpoint.save(self.settings, self._parts, self.learning.replay)
        self._write_run()
        return path

    def finish(self) -> Path:
        """
        Write checkpoint and final model, and close the files; return the model's folder.

        Raises:
            RunError: as for `save`.
        """
        if not self._finished:
            self._finished = True
            self.save()
            self._save_model(
                self.folder.final, self.learning.learner.acting_tensors(), self.version,
                self.moment)
            self._record.close()
        return self.folder.final
