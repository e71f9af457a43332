# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Files of laps: written whole after every lap, so that an evaluation can be gone on with."""
from __future__ import annotations

from collections.abc import Iterator
import contextlib
import csv
import dataclasses
import io
import json
import os
from pathlib import Path
from typing import Any

from carracing_dqn.evaluation.errors import ResultsError
from carracing_dqn.evaluation.laps import Lap
from carracing_dqn.evaluation.policies import MODEL
from carracing_dqn.evaluation.statistics import Statistics, statistics_of
from msgs_bridge.atomic_write import write_text
from msgs_bridge.file_lock import lock
from msgs_bridge.plain_text import plain
from msgs_bridge.regular_file import read_regular
from msgs_bridge.step import MAX_WHOLE

FORMAT = 'carracing_dqn evaluation 1'
MAX_BYTES = 64 * 2**20
# where commands write what belongs to no run
RUNS = Path('runs')
COLUMNS = tuple(field.name for field in dataclasses.fields(Lap))
_KINDS = {'int': (int,), 'float': (int, float), 'int | None': (int, type(None)),
          'bool | None': (bool, type(None))}


@dataclasses.dataclass
class Results:
    """
    The laps of one policy in one simulator.

    Attributes:
        policy: `PolicySource.identity()`.
        simulator: name of the simulator; 'graph' when they were driven over topics.
        simulator_source: `sources.simulator_source`, '' where that is not known.
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
    simulator_source: str = ''

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
            'simulator_source': self.simulator_source,
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
    data = read_regular(path, MAX_BYTES, ResultsError)
    try:
        values = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise ResultsError(f'{path} is not JSON: {error}') from None
    if not isinstance(values, dict) or values.get('format') != FORMAT:
        raise ResultsError(f'{path} is not a file of carracing evaluate (no format {FORMAT!r})')
    try:
        laps = [_lap(row) for row in values['laps']]
        if len({lap.seed for lap in laps}) < len(laps):
            raise ValueError('a seed comes twice')
        found = Results(
            policy=values['policy'], simulator=values['simulator'],
            laps={lap.seed: lap for lap in laps}, wanted=values['wanted'],
            seconds=values['seconds'], machine=values['machine'],
            simulator_source=values.get('simulator_source', ''))
        for name, kinds in (
            ('policy', (dict,)), ('machine', (dict,)), ('simulator', (str,)),
            ('simulator_source', (str,)), ('wanted', (int,)), ('seconds', (int, float)),
        ):
            value = getattr(found, name)
            if type(value) not in kinds or name in ('wanted', 'seconds') and not (
                    0 <= value <= MAX_WHOLE):
                raise TypeError(f'{name} is {plain(value)}')
        return found
    except (KeyError, TypeError, ValueError) as error:
        raise ResultsError(f'{path} is damaged: {type(error).__name__} {error}') from None


def resume(
    path: Path | str, policy: dict[str, Any], simulator: str, seeds: range,
    simulator_source: str = '',
) -> Results:
    """
    Return what a file holds already of an evaluation, or empty results without a file.

    Args:
        path: the file.
        policy: `PolicySource.identity()`.
        simulator: its name.
        seeds: of the laps.
        simulator_source: `sources.simulator_source`, '' to compare none.

    Raises:
        ResultsError: the file is damaged, or its laps are of another evaluation.
    """
    empty = Results(policy, simulator, simulator_source=simulator_source)
    if not Path(path).exists():
        return empty
    found = read_json(path)
    advice = 'name another file, or delete it'
    # older files do not say it
    known = bool(found.simulator_source and simulator_source)
    for what, theirs, ours in (
        ('simulator', found.simulator, simulator),
        ('simulator_source', known and found.simulator_source, known and simulator_source),
        *((key, found.policy.get(key), policy.get(key))
          # a model is known by its weights, whatever its folder is called
          for key in sorted(found.policy.keys() | policy.keys())
          if key != 'name' or policy.get('kind') != MODEL),
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
    values = {}
    for field in dataclasses.fields(Lap):
        value = row[field.name]
        # written so that NaN fails: every comparison with it is False
        if type(value) not in _KINDS[field.type] or not abs(value or 0) <= MAX_WHOLE:
            raise TypeError(f'{field.name} is {plain(value)}')
        values[field.name] = float(value) if field.type == 'float' else value
    visited, total = values['tiles_visited'], values['tiles_total']
    if values['frames'] < 1 or (visited, total) != (None, None) and (
            None in (visited, total) or not 0 <= visited <= total or total < 1):
        raise ValueError(f'a lap of {values["frames"]} frames and {visited} of {total} tiles')
    return Lap(**values)


@contextlib.contextmanager
def locked(path: Path | str) -> Iterator[None]:
    """
    Keep other processes from a file of laps inside the block: each would lose the other's.

    Raises:
        ResultsError: another one writes it.
        OSError: the folder cannot be written.
    """
    path = Path(path)
    place = path.parent / f'.{path.name}.lock'
    while True:
        handle = os.open(
            place, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK, 0o644)
        if not lock(handle, ResultsError(f'{path}: another process writes its laps there')):
            break
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(handle), os.stat(place)):
                break
        # who had it before has removed it in between
        os.close(handle)
    try:
        yield
    finally:
        place.unlink(missing_ok=True)
        os.close(handle)
