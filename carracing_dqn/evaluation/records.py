# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What a run wrote down, read so that whatever is there can be shown."""
from __future__ import annotations

import contextlib
import dataclasses
import json
import math
import os
from pathlib import Path
from typing import Any

from carracing_dqn.evaluation.errors import RecordsError, ResultsError
from carracing_dqn.evaluation.policies import MODEL
from carracing_dqn.evaluation.results import read_json, Results
from carracing_dqn.evaluation.tables import read_table, Table
from carracing_dqn.simulation.profiles import found_from, SUFFIX
from carracing_dqn.simulation.registry import CARRACING, DEFAULT
from dqn_policy_node.model_record import read_model_record
from dqn_policy_node.shipped_models import RANDOM
from msgs_bridge.errors import BridgeError
from msgs_bridge.plain_text import plain
from msgs_bridge.regular_file import read_regular
from msgs_bridge.simulator import FRAME_SECONDS
from msgs_bridge.yaml_text import load_yaml

EPISODE_COLUMNS = (
    'episode', 'train_reward', 'validation_reward', 'epsilon', 'learning_rate', 'frames',
    'loss', 'q_mean', 'wall_seconds')
VALIDATION_COLUMNS = ('episode', 'wall_seconds', 'mean', 'std', 'completed')
UPDATE_COLUMNS = (
    'updates', 'loss', 'td_error', 'q_mean', 'learning_rate', 'epsilon', 'wall_seconds')
# below a model folder, the record of its training
RECORD_FOLDERS = ('', 'training', 'record')
MODEL_FOLDERS = ('best', 'final', '')
MAX_TEXT_BYTES = 4 * 2**20
# of a run: as many digits as a file may hold fit no float
MOST_SECONDS = 1e12
# of a sentence about what is wrong; paths may be long
MAX_PROBLEM = 1000


@dataclasses.dataclass
class Run:
    """
    One run and all that is known of it.

    Attributes:
        name: short name for legends.
        path: folder of its records.
        episodes, validation, updates: its CSV files; empty when they are not there.
        config: its hyperparameters, empty when unknown.
        record: its `run.json`, empty when unknown.
        evaluation: greedy laps of its model on test tracks.
        dummy: laps of the dummy agent.
        model: folder of the model to drive with, if there is one.
        problems: a sentence for everything that was wrong or missing.
    """

    name: str
    path: Path
    episodes: Table = dataclasses.field(default_factory=Table)
    validation: Table = dataclasses.field(default_factory=Table)
    updates: Table = dataclasses.field(default_factory=Table)
    config: dict[str, Any] = dataclasses.field(default_factory=dict)
    record: dict[str, Any] = dataclasses.field(default_factory=dict)
    evaluation: Results | None = None
    dummy: Results | None = None
    model: Path | None = None
    problems: list[str] = dataclasses.field(default_factory=list)

    @property
    def simulator(self) -> str:
        """Return the simulator that it learned in, as it is named here."""
        name = self.config.get('simulator', DEFAULT)
        return found_from(name, self.path) if isinstance(name, str) else DEFAULT

    @property
    def in_carracing(self) -> bool:
        """Return whether it learned in CarRacing, so that it stands beside the document."""
        return self.simulator in CARRACING

    @property
    def wall_seconds(self) -> float | None:
        """Return how long it has trained, by its record or its last rows; None when unknown."""
        known = [float(table.known('wall_seconds')[0].max())
                 for table in (self.episodes, self.updates) if table.has('wall_seconds')]
        value = self.record.get('wall_seconds')
        if type(value) in (int, float) and 0 <= value < math.inf:
            # the record of a run that goes on is as old as its last checkpoint
            known.append(float(min(value, MOST_SECONDS)))
        return max(known, default=None)


def load_run(folder: Path | str) -> Run:
    """
    Read a run folder, or a model folder with the record of its training below.

    Raises:
        RecordsError: there is no such folder, or nothing in it to report.
    """
    folder = Path(os.path.expanduser(folder))
    if not folder.is_dir():
        raise RecordsError(f'{folder}: there is no such run folder')
    path = next((folder / name for name in RECORD_FOLDERS
                 if (folder / name / 'episodes.csv').is_file()), folder)
    run = Run(plain(folder.resolve().name), path)
    for kind, columns in (
        ('episodes', EPISODE_COLUMNS), ('validation', VALIDATION_COLUMNS),
        ('updates', UPDATE_COLUMNS),
    ):
        table, problems = read_table(path / f'{kind}.csv', columns)
        setattr(run, kind, table)
        run.problems += problems
    run.config = _mapping(path / 'config.yaml', run.problems)
    run.record = _mapping(path / 'run.json', run.problems)
    if run.record.get('complete') is False:
        run.problems.append('The run is not complete: it is still going on, or was stopped.')
    run.model = next((folder / name for name in MODEL_FOLDERS
                      if (folder / name / 'model.json').is_file()), None)
    _read_evaluations(run, {folder, path})
    if not (run.episodes.rows or run.validation.rows or run.updates.rows or run.evaluation):
        raise RecordsError(
            f'{folder} holds nothing to report: '
            + ' '.join(run.problems[:3]) + ' And no evaluation*.json either.')
    return run


def add_results(run: Run, path: Path | str, *, dummy: bool | None = None) -> None:
    """
    Add laps of `carracing evaluate` to a run, as its evaluation or as the dummy agent's.

    Args:
        run: takes them, in place of those that it has.
        path: the file.
        dummy: whether they must be the dummy agent's, or must not; None takes either.

    Raises:
        ResultsError: the file is not there, is damaged, is something else, or its laps were
            driven elsewhere than the run.
    """
    results = read_json(path)
    is_dummy = results.policy.get('kind') == RANDOM
    if dummy is not None and is_dummy != dummy:
        raise ResultsError(f'{path} holds laps of {plain(results.policy.get("name"))}; laps of '
                           f'{RANDOM if dummy else "a model"} are wanted')
    if not _same_simulator(run, results):
        raise ResultsError(f'{path} holds laps in {plain(results.simulator)}, and {run.name} '
                           f'learned in {plain(run.simulator)}')
    if not results.laps:
        run.problems.append(f'{Path(path).name} holds no laps yet.')
        return
    if len(results.laps) < results.wanted:
        run.problems.append(
            f'{Path(path).name} holds {len(results.laps)} of {results.wanted} laps.')
    if is_dummy:
        run.dummy = results
    else:
        run.evaluation = results
        if other := _other_driver(run, results):
            run.problems.append(f'{Path(path).name} holds laps {other}.')


def _same_simulator(run: Run, results: Results) -> bool:
    """Return whether laps were driven in what a run learned in."""
    # over topics in CarRacing alone
    in_carracing = results.simulator in (*CARRACING, 'graph')
    if run.in_carracing or in_carracing:
        return run.in_carracing and in_carracing
    # a profile has another path from elsewhere
    own, other = (Path(name).stem if name.endswith(SUFFIX) else name
                  for name in (run.simulator, results.simulator))
    return own == other


def _other_driver(run: Run, results: Results) -> str:
    """Return by whom laps are known to be driven, other than the model of a run; '' for none."""
    if results.policy.get('kind', MODEL) != MODEL:
        return f'of {plain(results.policy.get("name"))}, not of the model of this run'
    weights, held = (results.policy.get(name) for name in ('weights_sha256', 'action_repeat'))
    if run.model is None or weights is None:
        return ''
    with contextlib.suppress(BridgeError):
        own = read_model_record(run.model)
        if own.weights_sha256 != weights:
            return f'of other weights than those in {run.model.name}'
        learned = round(own.description.action_seconds / FRAME_SECONDS)
        if held not in (None, learned):
            return (f'in which actions were held for {plain(held)} frames; the model was trained '
                    f'with {learned}')
    return ''


def _read_evaluations(run: Run, folders: set[Path]) -> None:
    for folder in sorted(folders):
        for path in sorted([*folder.glob('evaluation*.json'), *folder.glob('dummy*.json')]):
            before = run.evaluation, run.dummy
            try:
                add_results(run, path)
            except ResultsError as error:
                run.problems.append(f'{plain(error, MAX_PROBLEM)}.')
                continue
            if (before[0] is not None and before[0] is not run.evaluation
                    or before[1] is not None and before[1] is not run.dummy):
                run.problems.append(f'There are several files of laps; {path.name} is shown.')


def _mapping(path: Path, problems: list[str]) -> dict[str, Any]:
    """Return the mapping of a YAML or JSON file, empty when there is none."""
    if not path.exists():
        problems.append(f'{path.name} is not there.')
        return {}
    try:
        text = read_regular(path, MAX_TEXT_BYTES, RecordsError).decode('utf-8')
        values = json.loads(text) if path.suffix == '.json' else load_yaml(
            text, path.name, RecordsError)
        if not isinstance(values, dict):
            raise ValueError('not a mapping')
    except (ValueError, RecursionError) as error:  # a RecordsError among them
        problems.append(f'{path.name} cannot be used: {plain(error)}.')
    else:
        return values
    return {}
