# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What a run writes down of itself: rows of the CSV files, and the sessions in `run.json`."""
from __future__ import annotations

from collections.abc import Mapping
import dataclasses
from typing import Any

from msgs_bridge.machine import describe_machine
from msgs_bridge.step import Step
from trainer_node.figures import Means, MeansState
from trainer_node.learning import Learning
from trainer_node.run_folder import now, RunFolder
from trainer_node.saved_state import Seconds
from trainer_node.tracking import Tracking

UPDATES_PER_ROW = 200


@dataclasses.dataclass(frozen=True)
class RecordState:
    """What `RunRecord` needs to go on: lengths of its files, and what is in no row yet."""

    positions: dict[str, int]
    of_episode: MeansState
    of_row: MeansState
    last_figures: dict[str, float]
    row_seconds: Seconds
    updates_per_second: float
    new_validation: float | None


class RunRecord:
    """
    The records of one run.

    Attributes:
        State: what `state` returns.
        last_figures: means of the last row of updates, and updates a second.
    """

    State = RecordState

    def __init__(
        self, folder: RunFolder, figures: tuple[str, ...], *, tensorboard: bool = False,
    ) -> None:
        """Open the files for a learner that gives some figures; raises RunError."""
        self._folder = folder
        self._tracking = Tracking(folder, figures, tensorboard=tensorboard)
        self._of_episode, self._of_row = Means(), Means()
        self.last_figures: dict[str, float] = {}
        self._row_seconds = 0.0
        self._updates_per_second = 0.0
        self._new_validation: float | None = None
        self._run: dict[str, Any] = {}
        # lengths of the files at the checkpoint that is gone on from
        self._positions: dict[str, int] | None = None

    def begin_session(
        self, run: dict[str, Any], *, device: object, seconds: float,
    ) -> None:
        """
        Note when and on what machine this part of the run began; cut rows after the checkpoint.

        Args:
            run: `run.json` so far.
            device: where it learns.
            seconds: wall time of the sessions before.
        """
        if self._positions is not None:
            self._tracking.set_back(self._positions)
        self._run = run
        run.setdefault('sessions', []).append({
            'started': now(), 'from_seconds': seconds, 'device': str(device),
            **describe_machine()})

    def write_run(self, *, seconds: float, complete: bool) -> None:
        """Write `run.json`."""
        self._run.update(wall_seconds=seconds, complete=complete)
        self._folder.write_record(self._run)

    def note(self, name: str, value: Any) -> None:
        """Keep a JSON value in `run.json` from its next writing on."""
        self._run[name] = value

    def noted(self, name: str) -> Any:
        """Return a value of `run.json`, None if it has none."""
        return self._run.get(name)

    @property
    def run(self) -> dict[str, Any]:
        """Return `run.json` without its sessions, for a model's record."""
        return {key: value for key, value in self._run.items() if key != 'sessions'}

    def updated(
        self, figures: Mapping[str, float], learning: Learning, *, epsilon: float,
        seconds: float,
    ) -> None:
        """Take the figures of an update; every so many write a row of their means."""
        self._of_episode.add(figures)
        self._of_row.add(figures)
        if learning.learner.updates % UPDATES_PER_ROW:
            return
        self._updates_per_second = self._of_row.count / max(seconds - self._row_seconds, 1e-9)
        self._row_seconds = seconds
        self.last_figures = self._of_row.take()
        self._tracking.updated({
            'updates': learning.learner.updates, 'decisions': learning.decisions,
            **self.last_figures, 'learning_rate': learning.learning_rate, 'epsilon': epsilon,
            'wall_seconds': seconds, 'updates_per_second': self._updates_per_second})

    def episode(
        self, step: Step, learning: Learning, *, epsilon: float, version: int, seconds: float,
        source: str = '',
    ) -> None:
        """
        Write a row for an episode that has ended.

        Args:
            step: its last one.
            learning: after the updates of its last transition.
            epsilon: what it was driven with.
            version: of the weights that went out last.
            seconds: wall time of the run.
            source: whose it was, if there are several.
        """
        info = step.info
        self._tracking.episode({
            'episode': learning.episodes - 1, 'train_reward': step.episode_return,
            'validation_reward': self._new_validation, 'epsilon': epsilon,
            'learning_rate': learning.learning_rate, 'frames': info.get('step'),
            'decisions': learning.decisions,
            **{name: info.get(name) for name in (
                'lap_finished', 'ended_early', 'tiles_visited', 'tiles_total',
                'standing_still')},
            **self._of_episode.take(), 'updates': learning.learner.updates,
            'replay_size': len(learning.replay), 'replay_ratio': learning.limiter.ratio,
            'weights_version': version, 'wall_seconds': seconds})
        self._new_validation = None
        if source:
            self._tracking.car_episode({
                'source': source, 'episode': step.episode, 'seed': step.seed,
                'train_reward': step.episode_return, 'frames': info.get('step'),
                'run_episode': learning.episodes - 1, 'decisions': learning.decisions,
                'weights_version': version, 'wall_seconds': seconds})

    def validated(self, row: Mapping[str, float]) -> None:
        """Write a row for a validation."""
        self._tracking.validated(dict(row))
        self._new_validation = row['mean']

    def figures(self) -> dict[str, float]:
        """Return the figures of the last updates, for displays."""
        return {'updates_per_second': self._updates_per_second, **self.last_figures}

    def state(self) -> RecordState:
        """Return lengths of the files, all of them on the disk, and what is in no row yet."""
        return RecordState(
            self._tracking.positions(), self._of_episode.state(), self._of_row.state(),
            self.last_figures, self._row_seconds, self._updates_per_second,
            self._new_validation)

    def restore(self, state: RecordState, _: object = None) -> None:
        """
        Go on from a checkpoint; KeyError, RunError if rows of then are not there any more.

        Later rows are cut off by `begin_session`: until then the run may still be refused.
        """
        self._tracking.check(state.positions)
        self._positions = state.positions
        self._of_episode.restore(state.of_episode)
        self._of_row.restore(state.of_row)
        self.last_figures = state.last_figures
        self._row_seconds = state.row_seconds
        self._updates_per_second = state.updates_per_second
        self._new_validation = state.new_validation

    def arrays(self) -> dict[str, Any]:
        """Return nothing: it has no arrays."""
        return {}

    def close(self) -> None:
        """Close the files."""
        self._tracking.close()

