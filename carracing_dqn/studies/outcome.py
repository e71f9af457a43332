# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What became of the runs of a study, read from their folders."""
from __future__ import annotations

from collections.abc import Sequence
import contextlib
import dataclasses
from pathlib import Path
from typing import Any

from carracing_dqn.evaluation.laps import Lap
from carracing_dqn.evaluation.results import read_json
from carracing_dqn.evaluation.statistics import moving_average, Statistics, statistics_of
from carracing_dqn.evaluation.tables import LARGEST, read_table, Table
from carracing_dqn.studies.one_run import LAPS, learned, PLAN, tested
from carracing_dqn.studies.schedule import FAILURE
from carracing_dqn.studies.study_file import PlannedRun, StudySettings
from dqn_policy_node.model_record import read_model_record
from msgs_bridge.errors import BridgeError
from msgs_bridge.plain_text import plain
from msgs_bridge.regular_file import read_regular
import numpy as np
from trainer_node.hyperparameters import load_preset
from trainer_node.run_folder import RunFolder

DONE, FAILED, UNFINISHED, NOT_BEGUN = 'done', 'failed', 'not finished', 'not begun'
# training episodes that the end of a run is judged by, and that a curve is averaged over
LAST_EPISODES = 100
WINDOW = 20
MAX_FAILURE_BYTES = 2**16
FIGURES = ('decisions', 'episodes', 'updates')


@dataclasses.dataclass(frozen=True)
class Curve:
    """
    How the return of training episodes rose.

    Attributes:
        places: decisions or episodes so far, at the end of each episode.
        returns: the environment's own return, mean of the episode and up to 19 before it.
    """

    places: np.ndarray
    returns: np.ndarray


@dataclasses.dataclass(frozen=True)
class Outcome:
    """
    What a run has come to.

    Attributes:
        run: which.
        state: DONE, FAILED, UNFINISHED or NOT_BEGUN.
        problem: why it failed.
        curve: of its training; empty before the first episode has ended.
        laps: test laps by seed; empty when there are none yet.
        training: return of each training episode.
        figures: decisions, episodes, updates and minutes so far, and mean Q-value of the actions
            in the last updates, as far as they are known.
    """

    run: PlannedRun
    state: str
    problem: str
    curve: Curve
    laps: dict[int, Lap]
    training: np.ndarray
    figures: dict[str, float]

    @property
    def statistics(self) -> Statistics | None:
        """Return those of the test laps, None without any."""
        ordered = [self.laps[seed] for seed in sorted(self.laps)]
        return statistics_of(ordered) if ordered else None

    @property
    def scores(self) -> np.ndarray:
        """Return what the run is compared by, float (tracks,): its laps, or its last episodes."""
        if self.laps:
            return np.array([self.laps[seed].episode_return for seed in sorted(self.laps)])
        return np.array([self.training[-LAST_EPISODES:].mean()])


def outcome_of(run: PlannedRun, settings: StudySettings, problem: str = '') -> Outcome:
    """
    Read the folder of a run; whatever is there and of these settings is used.

    Args:
        run: which.
        settings: of the study.
        problem: why it has just failed, if it did.
    """
    folder = RunFolder(run.folder)
    if run.problem or not _is_of(run):
        problem = run.problem or problem
        return _nothing(run, FAILED if problem else NOT_BEGUN, problem)
    episodes, _ = read_table(folder.episodes, ())
    training, laps = _column(episodes, 'train_reward'), _laps(folder, settings)
    done = learned(folder) and len(laps) == settings.laps and bool(laps or len(training))
    problem = '' if done else problem or _failure(run.folder)
    if learned(folder) and not settings.laps and not len(training):
        problem = problem or 'no episode ended, and without laps it is judged by those'
    state = DONE if done else FAILED if problem else UNFINISHED
    return Outcome(run, state, problem, _curve(episodes, settings.curve),
                   laps if done else {}, training, _figures(folder, episodes))


def _is_of(run: PlannedRun) -> bool:
    """Return whether what lies in a run's folder was begun with its settings."""
    try:
        return load_preset(run.folder / PLAN) == run.settings
    except BridgeError:
        return False


def _nothing(run: PlannedRun, state: str, problem: str) -> Outcome:
    empty = np.empty(0)
    return Outcome(run, state, problem, Curve(empty, empty), {}, empty, {})


def _laps(folder: RunFolder, settings: StudySettings) -> dict[int, Lap]:
    """Return the laps that the study asks for, driven with the weights that it asks for."""
    seeds = range(settings.test_seed, settings.test_seed + settings.laps)
    with contextlib.suppress(BridgeError):
        found = read_json(folder.path / LAPS)
        own = read_model_record(tested(folder, settings.model)).weights_sha256
        if found.policy.get('weights_sha256') == own:
            return {seed: found.laps[seed] for seed in seeds if seed in found.laps}
    return {}


def _failure(folder: Path) -> str:
    with contextlib.suppress(BridgeError):
        said = read_regular(folder / FAILURE, MAX_FAILURE_BYTES, BridgeError)
        return plain(said.decode('utf-8', 'replace').strip(), 400)
    return ''


def _column(table: Table, name: str) -> np.ndarray:
    return table.known(name)[0] if table.has(name) else np.empty(0)


def _curve(episodes: Table, against: str) -> Curve:
    if not episodes.has('train_reward', 'decisions', 'episode'):
        return Curve(np.empty(0), np.empty(0))
    numbers, decisions, returns = episodes.known('episode', 'decisions', 'train_reward')
    places = decisions if against == 'decisions' else numbers + 1
    return Curve(places, moving_average(returns, WINDOW))


def _figures(folder: RunFolder, episodes: Table) -> dict[str, float]:
    """Return how far a run has come: as its last model says, or the last row of its episodes."""
    figures = {'episodes': float(episodes.rows)}
    for name in ('decisions', 'updates'):
        if len(values := _column(episodes, name)):
            figures[name] = float(values[-1])
    found: dict[str, Any] = {}
    with contextlib.suppress(BridgeError, KeyError):
        training = read_model_record(folder.final).training
        found = {name: training[name] for name in FIGURES}
    updates, _ = read_table(folder.updates, ())
    if len(values := _column(updates, 'q_mean')):
        found['q_mean'] = float(values[-1])
    found['wall_seconds'] = folder.read_record().get('wall_seconds')
    # a record is anybody's JSON
    figures.update({name: float(value) for name, value in found.items()
                    if type(value) in (int, float) and abs(value) <= LARGEST})
    figures['minutes'] = figures.pop('wall_seconds', 0.0) / 60
    return figures


def scores_of(outcomes: Sequence[Outcome]) -> np.ndarray:
    """Return the scores of finished runs of one arm, float (runs, tracks)."""
    return np.array([outcome.scores for outcome in outcomes if outcome.state == DONE])
