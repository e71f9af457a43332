# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
The card of a model: its README, made from `model.json` and the record of its training.

`python -m carracing_dqn.evaluation.model_card models/*` writes the cards anew; a test holds the
shipped ones to their records. Its first lines are those that model hubs read.
"""
from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
import sys

from carracing_dqn.evaluation.errors import RecordsError
from carracing_dqn.evaluation.records import load_run, Run
from carracing_dqn.evaluation.results import Results
from carracing_dqn.simulation.profiles import profile_of
from dqn_policy_node.model_folder import load_model, Model
from msgs_bridge.atomic_write import write_bytes
from msgs_bridge.errors import BridgeError
from msgs_bridge.exit_codes import ERROR
from msgs_bridge.last_line import say
from msgs_bridge.plain_text import plain
from msgs_bridge.seeds import is_validation

CARD = 'README.md'
LICENSE = 'Apache-2.0'
# characters of a cell of a table
CELL = 1000


def model_card(folder: Path | str) -> str:
    """
    Return the card of a model folder with the record of its training, as Markdown.

    Args:
        folder: with `model.json`; `record/seed_*` below are runs of the same recipe that were not
            chosen.

    Raises:
        ModelError, RecordsError: the folder cannot be used.
    """
    folder = Path(folder)
    model, run = load_model(folder), load_run(folder)
    others = [load_run(path) for path in sorted(run.path.glob('seed_*'))]
    try:
        return '\n'.join([
            *_head(folder.name, run), *_what(model), *_training(model, run),
            *_test(run, others), *_limits(run, others), *_use(folder.name, run)])
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        # a record is anybody's JSON
        raise RecordsError(f'{folder}: the record of its training is not whole: '
                           f'{type(error).__name__}: {plain(error)}') from None


def _head(name: str, run: Run) -> Iterator[str]:
    about = profile_of(run.simulator).about or run.simulator
    yield from (
        '---', f'license: {LICENSE.lower()}', 'library_name: carracing_dqn',
        'pipeline_tag: reinforcement-learning',
        f'tags: [deep-reinforcement-learning, dqn, ros2, {run.simulator}]', '---',
        f'# Model {name}', '',
        '<!-- made by `python -m carracing_dqn.evaluation.model_card`; not to be edited -->', '',
        'A DQN policy that drives by the picture alone. It learned in '
        f'`{run.simulator}`: {about}.', '')


def _what(model: Model) -> Iterator[str]:
    own, network = model.description, model.description.network
    before = own.preprocessing
    height, width = before.shape
    layers = ', '.join(f'{layer.filters} of {layer.kernel}x{layer.kernel} stride {layer.stride}'
                       for layer in network.convolutions)
    yield from (
        '## What it is', '', '| | |', '|---|---|',
        f'| takes | rgb frames of {before.frame_width}x{before.frame_height} |',
        f'| sees | {f"the last {own.frame_stack}" if own.frame_stack > 1 else "the last"} as gray '
        f'{width}x{height}'
        f'{f", {own.stack_seconds:g} s apart" if own.frame_stack > 1 else ""} |',
        f'| decides | every {own.action_seconds:g} s, by the highest of '
        f'{len(own.action_space)} Q-values (`{own.action_space.name}`) |',
        '| gives | linear (gas, brake) and angular (left above 0), from -1 to 1 |',
        f'| network | convolutions {layers}; {network.hidden} units'
        f'{", dueling" if network.dueling else ""}; {own.parameters:,} weights |',
        f'| weights | version {model.version}, safetensors |', '')


def _training(model: Model, run: Run) -> Iterator[str]:
    training, session = model.training, run.record['sessions'][-1]
    best, seeds = training['best_validation'], run.record['seeds']
    command, comma, more = (run.record.get('command') or (
        f'carracing train --simulator {run.simulator} --set seed={run.config["seed"]}')
    ).partition(', ')
    where = (
        'in one process without ROS, simulator, policy, trainer and validation by turns'
        if command.startswith('carracing study') else
        'through the ROS graph: simulator, policy, trainer and validation as processes')
    yield from (
        '## How it was trained', '',
        f'From {run.config.get("initial_model") or "random weights"}, {where}.', '',
        '| | |', '|---|---|',
        f'| command | `{command}`{comma}{more} |')
    settings = [f'{name} {value}' for name, value in profile_of(run.simulator).settings.items()
                if isinstance(value, (str, int, float))]
    if settings:
        yield f'| simulator | `{run.simulator}`: {", ".join(settings)} |'
    yield from (
        f'| seeds | training {seeds["training"]}, validation from {seeds["validation"]} |',
        f'| until these weights | {training["wall_seconds"] / 60:.0f} minutes, '
        f'{training["episodes"]:,} episodes, {training["decisions"]:,} decisions, '
        f'{training["updates"]:,} updates |',
        f'| machine | {session["cores"]} cores of {session["processor"]}, learning on '
        f'{session["device"]} |',
        f'| code | {session["code"]}, torch {session["libraries"]["torch"]} |',
        f'| begun | {run.record["started"]} |',
        f'| chosen by | validation: {best["episodes"]:.0f} greedy episodes, '
        f'{_spread(best["mean"], best["std"])} |')
    for key, name in (('choice', 'choice'), ('what_else_ran', 'what else ran')):
        if run.record.get(key):
            yield f'| {name} | {plain(run.record[key], CELL)} |'
    yield from ('', 'Every hyperparameter is in `record/config.yaml`, every episode in '
                '`record/episodes.csv`.', '')


def _test(run: Run, others: list[Run]) -> Iterator[str]:
    tested = run.evaluation
    if tested is None:
        return
    seeds = [lap.seed for lap in tested.ordered]
    yield from (
        '## Test', '',
        f'Greedy, one attempt at each of the seeds {seeds[0]} to {seeds[-1]}, which neither '
        f'training nor validation drew, in `{tested.simulator}`, by its own reward.', '',
        '| | minutes of training | mean | median | lowest, highest | laps finished |',
        '|---|---:|---:|---:|---:|---:|')
    for one in sorted([run, *others], key=lambda one: one.config['seed']):
        if one.evaluation is not None:
            mark = '**' if one is run else ''
            yield _row(f'{mark}training seed {one.config["seed"]}{mark}', one.evaluation,
                       f'{(one.wall_seconds or 0) / 60:.0f}')
    if run.dummy is not None:
        yield _row('uniform random actions', run.dummy, '')
    yield ''
    known = [one for one in [run, *others] if one.evaluation is not None]
    if others:
        worst = min(known, key=lambda one: one.evaluation.statistics.mean)
        found = worst.evaluation.statistics
        yield from (
            f'Shipped is the best of {len(known)} training seeds by validation. The worst of them '
            f'by test is seed {worst.config["seed"]}: '
            f'{_spread(found.mean, found.std)}, lowest {found.minimum:.1f}.', '')


def _row(name: str, results: Results, minutes: str) -> str:
    found = results.statistics
    finished = '' if found.completed is None else (
        f'{round(found.completed * found.episodes)} of {found.episodes}')
    return (f'| {name} | {minutes} | {_spread(found.mean, found.std)} | {found.median:.1f} | '
            f'{found.minimum:.1f}, {found.maximum:.1f} | {finished} |')


def _spread(mean: float, std: float) -> str:
    return f'{mean:.2f} ± {std:.2f}'


def _limits(run: Run, others: list[Run]) -> Iterator[str]:
    yield from ('## Limits', '')
    found = run.evaluation.statistics if run.evaluation is not None else None
    if found is not None and found.completed is not None:
        lost = found.episodes - round(found.completed * found.episodes)
        yield (f'- {lost} of {found.episodes} test laps were not finished.' if lost else
               f'- All {found.episodes} test laps were finished; by the interval of Wilson (95 %) '
               f'{100 * (1 - found.completed_low):.0f} of 100 may still be lost.')
    if not others:
        yield '- One training run: what another seed would have given is not known.'
    if not is_validation(run.record['seeds']['validation'], 1):
        yield ('- Its seeds are outside of the spaces that cannot meet: some of its validation '
               'tracks may have been driven in training, no test track was (docs/learning.md, '
               'Seeds).')
    if 'track' in (settings := profile_of(run.simulator).settings):
        yield f'- It learned on one track, `{settings["track"]}`, and was tested there.'
    if run.record.get('complete') is False:
        yield '- Its training was stopped early; it shows how far that run got.'
    yield from (
        f'- It knows the pictures of `{run.simulator}` at their size, colours and field of view. '
        'What it does in others is untested, or stands in docs/simulators.md.',
        '- It has driven in simulation alone. Nothing makes it safe for a vehicle with people '
        'near it.', '')


def _use(name: str, run: Run) -> Iterator[str]:
    yield from (
        '## Use', '', '```sh',
        f'carracing run --model {name}'
        + ('' if run.in_carracing else f' --simulator {run.simulator}'),
        f'carracing report models/{name}                      # every curve and figure',
        f'carracing export {name} --onnx {name}.onnx', '```', '',
        '```python', 'from dqn_policy_node import load_policy',
        f"linear, angular = load_policy('{name}').act(frame)   # uint8 rgb, a frame after the "
        'other', '```', '',
        f'Licence: {LICENSE}.', '')


def main(folders: list[str]) -> int:
    """Write the cards of model folders; return the exit code."""
    try:
        for path in map(Path, folders):
            # a record may hold halves of signs, which no file can
            write_bytes(path / CARD, model_card(path).encode('utf-8', 'replace'))
    except (BridgeError, OSError) as error:
        say(f'error: {plain(error, CELL)}')
        return ERROR
    return 0


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
