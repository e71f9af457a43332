# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
The one order in which a run is driven: by the node, from bags and in a single process.

    driver = Driver(training, publish)
    for transition in transitions:
        driver.add(transition)
        if not driver.turn():
            break
    driver.close()
"""
from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
import queue
import time

from msgs_bridge.errors import MessageError
from msgs_bridge.transitions import Transition
from trainer_node.outlook import Outlook
from trainer_node.training import Training

# updates from demonstrations between two turns, so that a run can be stopped meanwhile
PRETRAINED_AT_ONCE = 10
# validations that may wait for a turn; of more nobody has asked for
MOST_WAITING = 100
# a snapshot of the figures is taken every so many transitions
STATUS_EVERY = 20


def _quiet(*_: str) -> None:
    """Say nothing."""


class Driver:
    """
    Does for a run what is due between two transitions.

    Weights go out, validations come in, checkpoints are written; when the run is complete, the
    last weights are validated before it ends. `add`, `turn`, `end` and `close` belong to one
    thread; `request_save`, `request_validation` and `validated` may be called from any.

    Attributes:
        training: the run.
        ended: whether nothing more is learned.
        done: whether nothing more is waited for.
        status: figures of a moment ago, a new mapping each time.
        left_out: why the last transition that could not be used was left out, or ''.
        outlook: where the run will end by its present pace.
    """

    def __init__(
        self, training: Training, publish: Callable[[bytes], Mapping[str, float] | None], *,
        last_validation_seconds: float = 0.0, say: Callable[[str], None] = _quiet,
        warn: Callable[[str, str], None] = _quiet,
    ) -> None:
        """
        Hand out the first weights.

        Args:
            training: the run.
            publish: takes each version of the weights; may drive the validation that they ask for
                and return its result, which otherwise comes by `validated`.
            last_validation_seconds: how long the validation of the last weights is waited for;
                0 does not ask for it.
            say: takes a line about what has happened.
            warn: takes what could not be used, `learning` or a source, and a line about it.
        """
        self.training = training
        self.ended = self.done = False
        self.left_out = ''
        self.status = training.status()
        self.outlook = Outlook(training.settings)
        self._publish = publish
        self._last_validation_seconds = last_validation_seconds
        self._say, self._warn = say, warn
        self._validations: queue.Queue[Mapping[str, float]] = queue.Queue(MOST_WAITING)
        # once at the next turn, however often they were asked for until then
        self._wants_save = self._wants_validation = False
        self._last_version = -1
        self._give_up_at = 0.0
        self._hand_out()

    @property
    def pretraining(self) -> bool:
        """Return whether turns learn from demonstrations, and no transition is to be taken yet."""
        return self.training.pretraining and not self.ended

    def request_save(self) -> None:
        """Let a checkpoint be written at the next turn."""
        self._wants_save = True

    def request_validation(self) -> None:
        """Let weights go out for validation at the next turn."""
        self._wants_validation = True

    def validated(self, values: Mapping[str, float]) -> None:
        """Take the result of a validation, `step.VALIDATION_FIELDS`, at the next turn."""
        try:
            self._validations.put_nowait(values)
        except queue.Full:
            self._warn('validation', 'left out: results come faster than they are taken')

    def add(self, transition: Transition, source: str = '') -> None:
        """
        Learn from the next transition, unless learning has ended.

        Args:
            transition: in the order of its source.
            source: whose it is, if there are several.

        Raises:
            LearningError: learning cannot go on.
        """
        if self.ended:
            return
        try:
            self.training.add(transition, source)
        except MessageError as error:
            self.left_out = str(error)
            self._warn(source or 'transitions', f'left out: {error}')
        if self.training.learning.taken % STATUS_EVERY == 0:
            self.outlook.note(self.training.moment)
            self._take_figures()

    def turn(self) -> bool:
        """
        Do what is due; return whether to go on.

        Raises:
            RunError: a file cannot be written.
        """
        for _ in range(self._validations.qsize()):
            self._take_validation(self._validations.get())
        if self._wants_save:
            self._wants_save = False
            self._save()
        if self._wants_validation:
            self._wants_validation = False
            self._hand_out(validate=True)
        if self.ended:
            if not self.done and time.monotonic() > self._give_up_at:
                self._warn('validation', 'no validation of the last weights came in time')
                self.done = True
            return not self.done
        training = self.training
        if self.pretraining:
            for _ in range(PRETRAINED_AT_ONCE):
                if training.pretraining:
                    training.pretrain()
            self._take_figures()
        if training.checkpoint_due():
            self._save()
        if training.weights_due():
            self._hand_out()
        if training.complete:
            self.end()
        return not self.done

    def end(self) -> None:
        """Learn no more, whether a limit is reached or not, and validate the last weights."""
        if self.ended:
            return
        self.ended = True
        self._take_figures()
        if not self._last_validation_seconds:
            self.done = True
            return
        self._last_version = self.training.version + 1
        self._give_up_at = time.monotonic() + self._last_validation_seconds
        self._hand_out(validate=True)

    def close(self) -> Path:
        """
        Save what was learned, with the final model if learning has ended; return where it is.

        Other processes may go on with the run then.

        Raises:
            RunError: it cannot be written, or learning has failed.
        """
        try:
            if self.ended or self.training.complete:
                return self.training.finish()
            return self.training.save()
        finally:
            self.training.folder.unlock()

    def _save(self) -> None:
        self._say(f'saved {self.training.save()}')

    def _hand_out(self, *, validate: bool | None = None) -> None:
        result = self._publish(self.training.next_weights(validate=validate))
        if result is not None:
            self.validated(result)

    def _take_validation(self, values: Mapping[str, float]) -> None:
        try:
            better = self.training.record_validation(values)
        except MessageError as error:
            self._warn('transitions', f'left out: {error}')
            return
        if better:
            self._say(f'version {values["version"]:.0f} is the best so far: '
                      f'{values["mean"]:.1f}')
        if values['version'] == self._last_version:
            self.done = True
        self._take_figures()

    def _take_figures(self) -> None:
        ahead = self.outlook.epsilon
        self.status = {**self.training.status(),
                       **({} if ahead is None else {'epsilon_at_end': ahead})}
