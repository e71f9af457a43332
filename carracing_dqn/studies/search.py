# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Arms that nobody has written down: settings drawn at random, or chosen by optuna from what came.

What was drawn is kept in `search.json` in the folder of the study, so that one that is stopped
goes on with the same trials.
"""
from __future__ import annotations

from collections.abc import Mapping
import dataclasses
import json
from pathlib import Path
from typing import Any

from carracing_dqn.studies.errors import StudyError
from carracing_dqn.studies.study_file import Arm, Study
from msgs_bridge.atomic_write import write_text
from msgs_bridge.errors import SettingsError
from msgs_bridge.plain_text import plain
from msgs_bridge.regular_file import read_regular
from msgs_bridge.settings import check_value, describe, from_mapping, setting, unknown_setting
import numpy as np
from trainer_node.hyperparameters import Hyperparameters

FILE = 'search.json'
FORMAT = 'carracing_dqn search 1'
MAX_BYTES = 2**22
RANDOM, TPE = 'random', 'tpe'
# of a number that was drawn
DIGITS = 4
# for a trial that is none of those before
MOST_DRAWS = 200


@dataclasses.dataclass(frozen=True)
class SearchSettings:
    """How a search draws its trials."""

    trials: int = setting(20, 'settings that are drawn, each tried with every seed',
                          low=1, high=1000)
    sampler: str = setting(
        RANDOM, 'at random, or by what earlier trials earned (tree-structured Parzen estimator, '
        "NeurIPS 2011; needs optuna: pip install 'carracing_dqn[search]')",
        choices=(RANDOM, TPE))
    seed: int = setting(0, 'seed of the draws', low=0, high=2**31 - 1)


@dataclasses.dataclass(frozen=True)
class Range:
    """
    What a hyperparameter is drawn from.

    Attributes:
        values: the choices; empty for a range of numbers.
        low, high: the range, both ends in it.
        log: whether every factor is as likely as every other.
        whole: whether only whole numbers are drawn.
    """

    values: tuple[Any, ...] = ()
    low: float = 0.0
    high: float = 0.0
    log: bool = False
    whole: bool = False

    def draw(self, random: np.random.Generator) -> Any:
        """Draw a value."""
        if self.values:
            return self.values[int(random.integers(len(self.values)))]
        if self.log:
            return self.rounded(float(np.exp(random.uniform(*np.log([self.low, self.high])))))
        return self.rounded(float(random.uniform(self.low, self.high)))

    def rounded(self, value: float) -> Any:
        """Return a number as it is tried: whole, or of four digits, and within the range."""
        value = round(value) if self.whole else float(f'{value:.{DIGITS}g}')
        return min(max(value, self.low), self.high)


class Search:
    """
    The trials of a study.

    Attributes:
        arms: those that were drawn so far.
    """

    def __init__(self, study: Study, output: Path) -> None:
        """
        Read what a study says of its search, and what was drawn before.

        Raises:
            StudyError: it is not accepted, optuna is missing, or what was drawn is of another.
        """
        try:
            self._read(study)
        except SettingsError as error:
            raise StudyError(f'study {study.name}: search: {error}') from None
        if self._settings.sampler == TPE:
            _optuna()
        self._seeds = study.seeds
        self._path = output / FILE
        self.arms: list[Arm] = []
        for values in self._drawn_before():
            self._add(values)

    def _read(self, study: Study) -> None:
        known = describe(SearchSettings)
        for key in study.search:
            if key not in known and key != 'space':
                raise SettingsError(unknown_setting(key, [*known, 'space']))
        self._settings = from_mapping(SearchSettings, {
            key: value for key, value in study.search.items() if key in known})
        space = study.search.get('space')
        if not isinstance(space, dict) or not space:
            raise SettingsError('space must be a mapping of hyperparameters to what they are '
                                'drawn from')
        self._space = {name: _range(name, values) for name, values in space.items()}

    @property
    def complete(self) -> bool:
        """Return whether all trials are drawn."""
        return len(self.arms) >= self._settings.trials

    def draw(self, scores: Mapping[str, float]) -> Arm | None:
        """
        Draw the next trial, and keep it; None when the space seems to have no other one.

        Args:
            scores: of the trials that are done, by the name of their arm.

        Raises:
            StudyError: it cannot be kept.
        """
        values = self._fresh(len(self.arms), scores)
        if values is None:
            return None
        arm = self._add(values)
        try:
            write_text(self._path, json.dumps({
                'format': FORMAT, 'trials': [dict(arm.set) for arm in self.arms]}) + '\n')
        except OSError as error:
            raise StudyError(f'{self._path}: {error.strerror}') from None
        return arm

    def _fresh(self, number: int, scores: Mapping[str, float]) -> dict[str, Any] | None:
        """Return values that were not drawn before, None if none are found."""
        drawn = [dict(arm.set) for arm in self.arms]
        if self._settings.sampler == TPE:
            values = self._chosen(number, scores)
            if values not in drawn:
                return values
        # of its number alone: a search that goes on draws the same
        random = np.random.default_rng([self._settings.seed, number])
        for _ in range(MOST_DRAWS):
            values = {name: own.draw(random) for name, own in self._space.items()}
            if values not in drawn:
                return values
        return None

    def _add(self, values: dict[str, Any]) -> Arm:
        arm = Arm(f'trial-{len(self.arms):03d}', 'drawn', set=values, seeds=self._seeds)
        self.arms.append(arm)
        return arm

    def _chosen(self, number: int, scores: Mapping[str, float]) -> dict[str, Any]:
        """Return what optuna chooses next."""
        optuna = _optuna()
        kinds = {name: _distribution(optuna, own) for name, own in self._space.items()}
        study = optuna.create_study(
            direction='maximize',
            sampler=optuna.samplers.TPESampler(seed=self._settings.seed + number))
        for arm in self.arms:
            if arm.name in scores:
                study.add_trial(optuna.trial.create_trial(
                    params=self._as_choices(arm.set), distributions=kinds,
                    value=scores[arm.name]))
        found = study.ask(kinds).params
        return {name: own.values[found[name]] if own.values else own.rounded(found[name])
                for name, own in self._space.items()}

    def _as_choices(self, values: Mapping[str, Any]) -> dict[str, Any]:
        return {name: own.values.index(values[name]) if own.values else values[name]
                for name, own in self._space.items()}

    def _drawn_before(self) -> list[dict[str, Any]]:
        if not self._path.is_file():
            return []
        try:
            record = json.loads(read_regular(self._path, MAX_BYTES, StudyError))
            trials = record['trials'] if record['format'] == FORMAT else None
            if not isinstance(trials, list) or not all(map(self._could_be, trials)):
                raise ValueError
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            raise StudyError(f'{self._path} holds trials of another search; delete it, or name '
                             'another folder by --output') from None
        return trials[:self._settings.trials]

    def _could_be(self, values: Any) -> bool:
        """Return whether values could have been drawn from the space."""
        return values.keys() == self._space.keys() and all(
            values[name] in own.values if own.values else
            type(values[name]) in (int, float) and own.low <= values[name] <= own.high
            for name, own in self._space.items())


def _range(name: str, values: Any) -> Range:
    """Return what a hyperparameter is drawn from; raises SettingsError."""
    known = describe(Hyperparameters)
    if name not in known:
        raise SettingsError(unknown_setting(name, known))
    kind, _, description = known[name]
    if isinstance(values, list) and values:
        return Range(tuple(check_value(name, kind, description, value) for value in values))
    if kind not in (int, float) or not isinstance(values, dict) or not (
            {'low', 'high'} <= values.keys() <= {'low', 'high', 'log'}):
        raise SettingsError(f'{plain(name)} must be a list of values'
                            + (', or low, high and log' if kind in (int, float) else ''))
    low, high = (check_value(name, kind, description, values[end]) for end in ('low', 'high'))
    log = values.get('log', False)
    if type(log) is not bool or low >= high or (log and low <= 0):
        raise SettingsError(f'{name}: low must be below high and, with log, above 0; log is true '
                            'or false')
    return Range((), low, high, log, kind is int)


def _distribution(optuna: Any, own: Range) -> Any:
    if own.values:
        # by place, because optuna takes no value for another of the same text
        return optuna.distributions.CategoricalDistribution(list(range(len(own.values))))
    kind = (optuna.distributions.IntDistribution if own.whole
            else optuna.distributions.FloatDistribution)
    return kind(own.low, own.high, log=own.log)


def _optuna() -> Any:
    """Return the package; raises StudyError without it."""
    try:
        import optuna
    except ImportError:
        raise StudyError("sampler: tpe needs the package 'optuna': pip install optuna") from None
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    return optuna
