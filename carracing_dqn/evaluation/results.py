# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Files of laps: written whole after every lap, so that an evaluation can be gone on with."""
from __future__ import annotations

import csv
import dataclasses
import io
import json
from pathlib import Path
from typing import Any

from carracing_dqn.evaluation.errors import ResultsError
from carracing_dqn.evaluation.laps import Lap
from carracing_dqn.evaluation.statistics import Statistics, statistics_of
from msgs_bridge.atomic_write import write_text

FORMAT = 'carracing_dqn evaluation 1'
MAX_BYTES = 64 * 2**20
# where commands write what belongs to no run
RUNS = Path('runs')
COLUMNS = tuple(field.name for field in dataclasses.fields(Lap))


@dataclasses.dataclass
class Results:
    """
    The laps of one policy in one simulator.

    Attributes:
        policy: `PolicySource.identity()`.
        simulator: name of the simulator; 'graph' when they were driven over topics.
        laps: by seed.
        wanted: how many laps were asked for.
        seconds: wall time spent on them, all processes together taken once.
        machine: versions and cores, for the record.
    """

    policy: dict[str, Any]
    simulator: str
    laps: dict[int, Lap] = dataclasses.field(default_factory=dict)
    wanted: int = 0
    seconds: float = 0.0
    machine: dict[str, Any] = dataclasses.field(default_factory=dict)

    @property
    def ordered(self) -> list[Lap]:
        """Return the laps in order of their seeds."""
        return [self.laps[seed] for seed in sorted(self.laps)]

    @property
    def statistics(self) -> Statistics:
        """Return their statistics; raises EvaluationError without any."""
        return statistics_of(self.ordered)

    def to_json(self) -> dict[str, Any]:
        """Return everything as JSON values."""
        return {
            'format': FORMAT,
            'policy': self.policy,
            'simulator': self.simulator,
            'wanted': self.wanted,
            'complete': len(self.laps) >= self.wanted,
            'seconds': round(self.seconds, 3),
            'machine': self.machine,
            'statistics': self.statistics.to_json() if self.laps else None,
            'laps': [dataclasses.asdict(lap) for lap in self.ordered],
        }


def write_json(path: Path | str, results: Results) -> None:
    """Write results whole or not at all; raises OSError."""
    write_text(path, json.dumps(results.to_json(), indent=1) + '\n')


def write_csv(path: Path | str, results: Results) -> None:
    """Write a row a lap, whole or not at all; truths are 1 and 0; raises OSError."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator='\n')
    writer.writerow(COLUMNS)
    for lap in results.ordered:
        values = dataclasses.astuple(lap)
        writer.writerow([int(v) if isinstance(v, bool) else v for v in values])
    write_text(path, text.getvalue())


def read_json(path: Path | str) -> Results:
    """
    Read what `write_json` wrote.

    Raises:
        ResultsError: the file is not there, is damaged, or is something else.
    """
    path = Path(path)
    try:
        if path.stat().st_size > MAX_BYTES:
            raise ResultsError(f'{path} is longer than {MAX_BYTES} bytes')
        values = json.loads(path.read_text(encoding='utf-8'))
    except OSError as error:
        raise ResultsError(f'{path}: {error.strerror}') from None
    except (ValueError, RecursionError) as error:
        raise ResultsError(f'{path} is not JSON: {error}') from None
    if not isinstance(values, dict) or values.get('format') != FORMAT:
        raise ResultsError(f'{path} is not a file of carracing evaluate (no format {FORMAT!r})')
    try:
        laps = [_lap(row) for row in values['laps']]
        return Results(
            policy=dict(values['policy']), simulator=str(values['simulator']),
            laps={lap.seed: lap for lap in laps}, wanted=int(values['wanted']),
            seconds=float(values['seconds']), machine=dict(values['machine']))
    except (KeyError, TypeError, ValueError) as error:
        raise ResultsError(f'{path} is damaged: {type(error).__name__} {error}') from None


def resume(path: Path | str, policy: dict[str, Any], simulator: str, seeds: range) -> Results:
    """
    Return what a file holds already of an evaluation, or empty results without a file.

    Raises:
        ResultsError: the file is damaged, or its laps are of another evaluation.
    """
    empty = Results(policy, simulator)
    if not Path(path).exists():
        return empty
    found = read_json(path)
    advice = 'name another file, or delete it'
    for what, theirs, ours in (
        ('simulator', found.simulator, simulator),
        *((key, found.policy.get(key), policy.get(key))
          for key in sorted(found.policy.keys() | policy.keys()) if key != 'name'),
    ):
        if theirs != ours:
            raise ResultsError(
                f'{path} holds laps of another evaluation: {what} is {theirs!r} there, '
                f'{ours!r} here; {advice}')
    foreign = [seed for seed in found.laps if seed not in seeds]
    if foreign:
        raise ResultsError(
            f'{path} holds {len(foreign)} laps of other seeds than {seeds.start} to '
            f'{seeds.stop - 1}, {min(foreign)} for one; {advice}')
    return found


def _lap(row: Any) -> Lap:
    """Return the lap of a JSON object; raises KeyError, TypeError or ValueError."""
    kinds = {'int': int, 'float': float, 'bool': bool, 'int | None': int, 'bool | None': bool}
    values = {}
    for field in dataclasses.fields(Lap):
        value = row[field.name]
        if isinstance(value, str) or value is None and field.default is not None:
            raise TypeError(f'{field.name} is {value!r}')
        values[field.name] = value if value is None else kinds[field.type](value)
    if values['frames'] < 1 or values['tiles_total'] is not None and values['tiles_total'] < 1:
        raise ValueError(f'a lap of {values["frames"]} frames and {values["tiles_total"]} tiles')
    return Lap(**values)
