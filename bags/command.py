# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""`carracing bag record|play|info|verify|recover|export`."""
from __future__ import annotations

import argparse
import json
import sys
from typing import Any

from rich.console import Console

from bags.errors import BagError
from bags.reader import BagReader
from bags.settings import PlayerSettings, RecorderSettings
from msgs_bridge.errors import BridgeError
from msgs_bridge.settings import describe, parse_text


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the subcommands of `carracing bag` to its parser."""
    commands = parser.add_subparsers(dest='bag_command', required=True, metavar='COMMAND')

    record = commands.add_parser('record', help='record topics until Ctrl-C')
    record.add_argument('folder', nargs='?', default='', help='new folder of the bag')
    _add_settings(record, RecorderSettings, skip=('folder',))

    play = commands.add_parser('play', help='publish a bag again')
    play.add_argument('bag', help='folder or single file')
    _add_settings(play, PlayerSettings, skip=('bag',))

    info = commands.add_parser('info', help='what a bag holds, and the episodes in it')
    info.add_argument('bag', help='folder or single file')
    info.add_argument('--json', action='store_true', help='print JSON instead of tables')
    _add_namespace(info)

    verify = commands.add_parser(
        'verify', help='check a bag and drive it again in the simulator, byte for byte')
    verify.add_argument('bag', help='folder or single file')
    verify.add_argument('--structure-only', action='store_true', help='do not drive it again')
    verify.add_argument('--json', action='store_true', help='print JSON')
    _add_namespace(verify)


def main(arguments: argparse.Namespace) -> int:
    """Run a subcommand; errors are one line on stderr and exit code 2, findings 1."""
    try:
        return COMMANDS[arguments.bag_command](arguments)
    except (BridgeError, OSError) as error:
        reason = f'{error.filename}: {error.strerror}' if isinstance(error, OSError) else error
        sys.stderr.write(f'error: {reason}\n')
        return 2
    except KeyboardInterrupt:
        return 130


def _record(arguments: argparse.Namespace) -> int:
    from bags.recorder_node import main as run
    return run(_ros_arguments(arguments, RecorderSettings, folder=arguments.folder))


def _play(arguments: argparse.Namespace) -> int:
    from bags.player_node import main as run
    return run(_ros_arguments(arguments, PlayerSettings, bag=arguments.bag))


def _info(arguments: argparse.Namespace) -> int:
    from bags.info import bag_info, show_info
    with BagReader(arguments.bag, strict=False) as reader:
        info = bag_info(reader, namespace=arguments.namespace)
    if arguments.json:
        sys.stdout.write(json.dumps(info, indent=2) + '\n')
    else:
        show_info(info, Console())
    return 0


def _verify(arguments: argparse.Namespace) -> int:
    from bags.verify import verify_bag
    with BagReader(arguments.bag) as reader:
        found = verify_bag(reader, namespace=arguments.namespace,
                           resimulate=not arguments.structure_only)
    if arguments.json:
        sys.stdout.write(json.dumps(found.as_dict(), indent=2) + '\n')
    else:
        _show_verification(found)
    return 0 if found.good else 1


def _show_verification(found: Any) -> None:
    write = sys.stdout.write
    for problem in found.problems:
        write(f'wrong: {problem}\n')
    for note in found.notes:
        write(f'note: {note}\n')
    if found.transitions:
        counts = ', '.join(f'{count} {name}' for name, count in found.transitions.items())
        write(f'transitions: {counts}\n')
    driven = found.resimulation
    if driven is not None:
        write(f'driven again: {driven.episodes} episodes, {driven.frames} frames, '
              f'{driven.differing_frames} differ\n')
    write(f'{found.messages} messages: {"good" if found.good else "NOT good"}\n')


COMMANDS = {'record': _record, 'play': _play, 'info': _info, 'verify': _verify}


def _add_settings(
    parser: argparse.ArgumentParser, settings_class: type, skip: tuple[str, ...],
) -> None:
    """Add an option for every setting that is not an argument of its own."""
    for name, (kind, default, description) in describe(settings_class).items():
        if name in skip:
            continue
        accepted = f'; {description.accepted}' if description.accepted else ''
        text = f'{description.text}{accepted} (default: {default!r})'.replace('%', '%%')
        option = '--' + name.replace('_', '-')
        if kind is bool:
            parser.add_argument(option, action='store_const', const='true', help=text)
        else:
            parser.add_argument(option, metavar=kind.__name__.upper(), help=text)


def _add_namespace(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        '--namespace', default='', help='where the topics of the car are; needed if several are')


def _ros_arguments(
    arguments: argparse.Namespace, settings_class: type, **given: str,
) -> list[str]:
    """
    Return the command line of a node for what was typed, checked before it starts.

    Raises:
        SettingsError: a value that is not accepted.
    """
    values = {
        name: getattr(arguments, name) for name in describe(settings_class)
        if name not in given and getattr(arguments, name) is not None}
    values.update({name: text for name, text in given.items() if text})
    result = ['carracing', '--ros-args']
    for name, text in values.items():
        value = parse_text(settings_class, name, text)
        # rcl reads parameter values as YAML; JSON is YAML that leaves no doubt about a text
        result += ['-p', f'{name}:={json.dumps(value)}']
    return result


__all__ = ['add_arguments', 'BagError', 'main']
