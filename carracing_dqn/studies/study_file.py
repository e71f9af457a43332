# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
A study as a YAML file: which settings (*arms*) are compared, with which seeds.

What is wrong with the file as a whole is an error; what is wrong with one run is told of that run,
and the others go on.
"""
from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
import dataclasses
import itertools
import os
from pathlib import Path
import re
from typing import Any

from carracing_dqn.studies.errors import StudyError
from carracing_dqn.studies.simulator_settings import choose_preset, settings_from
from msgs_bridge.errors import BridgeError, SettingsError
from msgs_bridge.plain_text import plain
from msgs_bridge.regular_file import read_regular
from msgs_bridge.settings import check_value, describe, from_mapping, setting, unknown_setting
from msgs_bridge.share import share_folders
from msgs_bridge.yaml_text import load_yaml
from trainer_node.hyperparameters import Hyperparameters, load_preset

FOLDER = Path('config') / 'studies'
MAX_BYTES = 2**20
MAX_RUNS = 1000
NAME = re.compile(r'[A-Za-z0-9][\w.=+-]{0,79}')
FINAL, BEST = 'final', 'best'
DECISIONS, EPISODES = 'decisions', 'episodes'


@dataclasses.dataclass(frozen=True)
class StudySettings:
    """What a study says in single values; runs and arms are beside them."""

    about: str = setting('', 'what is asked, in a sentence or two')
    preset: str = setting('', 'preset of the runs: a name or the path of a YAML file; empty: '
                          "racing, or what the simulator's profile names")
    simulator: str = setting('', "what the runs drive in, by name or profile; empty: the preset's")
    laps: int = setting(30, 'test laps of each finished run; 0 compares the last training '
                        'episodes instead', low=0, high=10_000)
    test_seed: int = setting(
        200_000, 'seed of the first test lap; 100000 is kept for models that are shipped, so that '
        'no study has chosen by their tracks', low=0, high=2**20 - 10_001)
    model: str = setting(FINAL, 'which weights of a run are tested: the last ones, or the best by '
                         'its validations', choices=(FINAL, BEST))
    curve: str = setting(DECISIONS, 'what the curves are drawn against',
                         choices=(DECISIONS, EPISODES))
    baseline: str = setting('', 'arm that the others are compared with; empty: the first')


@dataclasses.dataclass(frozen=True)
class Arm:
    """
    Settings that are tried with every seed.

    Attributes:
        name: unique in the study; a folder is called so.
        about: what it is, in a few words.
        preset, simulator: in place of the study's; empty: the study's.
        set: hyperparameters in place of the preset's and the study's.
        seeds: one run each.
    """

    name: str
    about: str = ''
    preset: str = ''
    simulator: str = ''
    set: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    seeds: tuple[int, ...] = ()


@dataclasses.dataclass(frozen=True)
class PlannedRun:
    """
    One run of a study.

    Attributes:
        arm: name of its arm.
        seed: its seed.
        folder: where it is, or will be.
        settings: its hyperparameters, all of them; None when they cannot be.
        problem: why it cannot be run, empty if it can.
    """

    arm: str
    seed: int
    folder: Path
    settings: Hyperparameters | None
    problem: str = ''

    @property
    def name(self) -> str:
        """Return what it is called in lines and tables."""
        return f'{self.arm}, seed {self.seed}'


@dataclasses.dataclass(frozen=True)
class Study:
    """
    A study as it was read.

    Attributes:
        name: that of its file.
        settings: its single values.
        set: hyperparameters of every run.
        arms: in the order of the file; grids after what is named.
        seeds: of every arm that names none.
        search: what `search:` says, empty if nothing is searched.
        notes: a sentence for everything that was set right in reading.
    """

    name: str
    settings: StudySettings
    set: Mapping[str, Any]
    arms: tuple[Arm, ...]
    seeds: tuple[int, ...]
    search: Mapping[str, Any]
    notes: tuple[str, ...]

    @property
    def baseline(self) -> str:
        """Return the name of the arm that the others are compared with, '' without arms."""
        return self.settings.baseline or (self.arms[0].name if self.arms else '')


def study_names() -> list[str]:
    """Return the names of the studies that come with the package."""
    return sorted({path.stem for folder in share_folders()
                   for path in (folder / FOLDER).glob('*.yaml')})


def find_study(name: str) -> Path:
    """Return the file of a study, by path or by name; raises StudyError."""
    path = Path(os.path.expanduser(name))
    # a name may be none that a file can have
    if os.path.isfile(path):
        return path
    for folder in share_folders():
        if NAME.fullmatch(name) and (folder / FOLDER / f'{name}.yaml').is_file():
            return folder / FOLDER / f'{name}.yaml'
    raise StudyError(f"no study {plain(name)!r}: neither a file nor one of the package's, which "
                     f'are {", ".join(study_names())}')


def load_study(path: Path) -> Study:
    """
    Read a study.

    Raises:
        StudyError: the file is not there, is no YAML, or says what is not accepted, in one line.
    """
    text = read_regular(path, MAX_BYTES, StudyError).decode('utf-8', 'replace')
    content = load_yaml(text, str(path), StudyError)
    try:
        return _study(path.stem, _mapping('a study', content))
    except SettingsError as error:
        raise StudyError(f'{path}: {error}') from None


def _study(name: str, content: dict[str, Any]) -> Study:
    parts = ('set', 'seeds', 'arms', 'grid', 'search')
    known = describe(StudySettings)
    for key in content:
        if key not in known and key not in parts:
            raise SettingsError(unknown_setting(key, [*known, *parts]))
    if not NAME.fullmatch(name):
        raise SettingsError(f'a study is called by its file, and {plain(name)!r} is no name')
    settings = from_mapping(
        StudySettings, {key: value for key, value in content.items() if key in known})
    notes: list[str] = []
    seeds = _seeds(content.get('seeds', [1, 2, 3]), 'the study', notes)
    arms = [_arm(arm, values, seeds, notes)
            for arm, values in _mapping('arms', content.get('arms', {})).items()]
    arms += _grid(_mapping('grid', content.get('grid', {})), seeds)
    twice = [arm for arm, count in Counter(arm.name for arm in arms).items() if count > 1]
    if twice:
        raise SettingsError(f'two arms are called {twice[0]!r}')
    search = _mapping('search', content.get('search', {}))
    if not arms and not search:
        arms = [Arm('preset', 'as the study says', seeds=seeds)]
    if sum(len(arm.seeds) for arm in arms) > MAX_RUNS:
        raise SettingsError(f'more than {MAX_RUNS} runs')
    if settings.baseline and settings.baseline not in [arm.name for arm in arms]:
        raise SettingsError(f'baseline is {plain(settings.baseline)!r}, which is no arm; there '
                            f'are {", ".join(arm.name for arm in arms)}')
    return Study(name, settings, _mapping('set', content.get('set', {})), tuple(arms), seeds,
                 search, tuple(notes))


def _arm(name: str, values: Any, seeds: tuple[int, ...], notes: list[str]) -> Arm:
    what = f'arm {plain(name)!r}'
    if not NAME.fullmatch(name):
        raise SettingsError(f'{what}: a folder is called so; accepted: letters, digits and '
                            '._=+- up to 80')
    values = _mapping(what, {} if values is None else values)
    known = ('about', 'preset', 'simulator', 'set', 'seeds')
    for key in values:
        if key not in known:
            raise SettingsError(f'{what}: {unknown_setting(key, known)}')
    for key in ('about', 'preset', 'simulator'):
        if not isinstance(values.get(key, ''), str):
            raise SettingsError(f'{what}: {key} must be a text')
    own = _seeds(values['seeds'], what, notes) if 'seeds' in values else seeds
    return Arm(**{**values, 'name': name, 'seeds': own,
                  'set': _mapping(f'{what}: set', values.get('set', {}))})


def _grid(grid: dict[str, Any], seeds: tuple[int, ...]) -> list[Arm]:
    """Return an arm for every combination of the values of some hyperparameters."""
    if not grid:
        return []
    for name, values in grid.items():
        if not isinstance(values, list) or not values:
            raise SettingsError(f'grid: {plain(name)} must be a list of values')
    found = []
    for values in itertools.product(*grid.values()):
        pairs = dict(zip(grid, values))
        text = '+'.join(f'{name}={_word(value)}' for name, value in pairs.items())
        if not NAME.fullmatch(text):
            raise SettingsError(f'grid: {plain(text)!r} cannot be the name of a folder; name '
                                'these arms below arms')
        found.append(Arm(text, set=pairs, seeds=seeds))
        if len(found) * max(len(seeds), 1) > MAX_RUNS:
            raise SettingsError(f'grid: more than {MAX_RUNS} runs')
    return found


def _word(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def _seeds(values: Any, what: str, notes: list[str]) -> tuple[int, ...]:
    """Return seeds, each once; one that is named twice is noted."""
    kind, _, description = describe(Hyperparameters)['seed']
    if not isinstance(values, list) or not values:
        raise SettingsError(f'{what}: seeds must be a list of whole numbers')
    seeds = [check_value('seed', kind, description, value) for value in values]
    twice = [str(seed) for seed, count in Counter(seeds).items() if count > 1]
    if twice:
        notes.append(f'{what}: seed {", ".join(twice)} is named more than once and is run once.')
    return tuple(dict.fromkeys(seeds))


def _mapping(what: str, values: Any) -> dict[str, Any]:
    if not isinstance(values, dict) or not all(isinstance(key, str) for key in values):
        raise SettingsError(f'{what} must be a mapping of names to values')
    return values


def plan(study: Study, arms: tuple[Arm, ...], output: Path) -> list[PlannedRun]:
    """
    Return the runs of arms, first those of the first seed; what cannot be run says why.

    Args:
        study: what they belong to.
        arms: its own, or what a search came up with.
        output: folder of the study.
    """
    runs, first = [], {}
    order = sorted((arm.seeds.index(seed), place, arm, seed)
                   for place, arm in enumerate(arms) for seed in arm.seeds)
    for _, _, arm, seed in order:
        folder = output / arm.name / f'seed-{seed}'
        try:
            settings = run_settings_of(study, arm, seed, folder)
        except BridgeError as error:
            runs.append(PlannedRun(arm.name, seed, folder, None, plain(error, 300)))
            continue
        problem = ''
        if settings in first:
            problem = f'the same settings and seed as {first[settings]}, which is run'
        first.setdefault(settings, f'{arm.name}, seed {seed}')
        runs.append(PlannedRun(arm.name, seed, folder, settings, problem))
    return runs


def run_settings_of(study: Study, arm: Arm, seed: int, folder: Path) -> Hyperparameters:
    """
    Return the hyperparameters of one run, limited by decisions or episodes and never by a clock.

    Raises:
        BridgeError: an unknown preset or simulator, a value that is not accepted, or no limit.
    """
    simulator = arm.simulator or study.settings.simulator
    preset = choose_preset(arm.preset or study.settings.preset or None, simulator or None)
    own = {**study.set, **arm.set}
    for name in ('seed', 'simulator'):
        if name in own:
            raise SettingsError(f'{name} is no hyperparameter to set here; name {name}'
                                f'{"s" if name == "seed" else ""} of the study or the arm')
    settings = load_preset(preset, {
        **(settings_from(simulator, preset, folder) if simulator else {}), **own, 'seed': seed})
    if settings.run_decisions:
        return settings.without_clock(settings.run_decisions)
    if not settings.run_episodes or settings.run_minutes or settings.validation_every_minutes:
        raise SettingsError(
            'a run of a study is as long on every machine: set run_decisions, or run_episodes '
            'without anything by minutes')
    return settings
