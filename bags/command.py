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
from bags.watched_reader import WatchedReader
from msgs_bridge.errors import BridgeError
from msgs_bridge.exit_codes import ERROR, INTERRUPTED
from msgs_bridge.last_line import say
from msgs_bridge.plain_text import plain
from msgs_bridge.settings import describe, parse_text

FILE_WIDTH = 140
# characters of a line about a bag
LINE = 300


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
    verify.add_argument('--simulator', metavar='NAME|MODULE:CLASS',
                        help='drive it again in this one (default: what the bag names)')
    _add_namespace(verify)

    recover = commands.add_parser('recover', help='make a bag that was cut off whole')
    recover.add_argument('bag', help='folder or single file; it is not touched')
    recover.add_argument('output', help='new folder')

    export = commands.add_parser('export', help='a lap as a video and as a table')
    export.add_argument('bag', help='folder or single file')
    export.add_argument('--video', metavar='FILE', help='new .mp4 or .webp file')
    export.add_argument('--csv', metavar='FILE', help='new .csv file, a row per step')
    export.add_argument('--episode', type=int, help='only this episode (default: all)')
    export.add_argument('--scale', type=int, default=4, help='size of the picture (default: 4)')
    export.add_argument('--speed', type=float, default=1.0,
                        help='2 = twice as fast as the car drove')
    _add_namespace(export)


def main(arguments: argparse.Namespace) -> int:
    """Run a subcommand; errors are one line on stderr and exit code 2, findings 1."""
    try:
        return COMMANDS[arguments.bag_command](arguments)
    except (BridgeError, OSError) as error:
        reason = error
        if isinstance(error, OSError):
            # a stream that cannot be written has no name
            reason = ': '.join(filter(None, (error.filename, error.strerror)))
        say(f'error: {plain(reason, LINE)}')
        return ERROR
    except KeyboardInterrupt:
        return INTERRUPTED


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
        # a file or a pipe has no width; wide enough that nothing is folded
        show_info(info, Console(width=None if sys.stdout.isatty() else FILE_WIDTH))
    return 0


def _verify(arguments: argparse.Namespace) -> int:
    from bags.verify import verify_bag
    with WatchedReader(arguments.bag, 'checking files and transitions', 'driving again') as reader:
        found = verify_bag(reader, namespace=arguments.namespace,
                           resimulate=not arguments.structure_only,
                           simulator=arguments.simulator)
    if arguments.json:
        sys.stdout.write(json.dumps(found.as_dict(), indent=2) + '\n')
    else:
        _show_verification(found)
    return 0 if found.good else 1


def _show_verification(found: Any) -> None:
    write = sys.stdout.write
    for problem in found.problems:
        write(f'wrong: {plain(problem, LINE)}\n')
    for note in found.notes:
        write(f'note: {plain(note, LINE)}\n')
    if found.transitions:
        counts = ', '.join(f'{count} {name}' for name, count in found.transitions.items())
        write(f'transitions: {counts}\n')
    driven = found.resimulation
    if driven is not None:
        write(f'driven again: {driven.episodes} episodes, {driven.frames} frames, '
              f'{driven.differing_frames} differ\n')
    compared = driven.frames - driven.missing_images if driven is not None else 0
    if not found.good:
        verdict = 'NOT good'
    elif compared:
        verdict = f'good, {compared} frames compared'
    else:
        verdict = 'whole, nothing was compared with a drive'
    write(f'{found.messages} messages: {verdict}\n')


def _recover(arguments: argparse.Namespace) -> int:
    from bags.recover import recover_bag
    recovery = recover_bag(arguments.bag, arguments.output)
    for remark in recovery.remarks:
        sys.stdout.write(f'{plain(remark, LINE)}\n')
    sys.stdout.write(
        f'{recovery.messages} messages in {recovery.chunks} chunks saved to {arguments.output}; '
        f'{recovery.bad_chunks} chunks and {recovery.lost_bytes} bytes lost\n')
    return 0


def _export(arguments: argparse.Namespace) -> int:
    from bags.export import export_csv, export_video
    if not arguments.video and not arguments.csv:
        raise BagError('nothing to export; give --video FILE, --csv FILE or both')
    with WatchedReader(arguments.bag, 'looking for frames', 'exporting') as reader:
        choice = {'namespace': arguments.namespace, 'episode': arguments.episode}
        if arguments.csv:
            rows = export_csv(reader, arguments.csv, **choice)
            sys.stdout.write(f'{rows} steps in {arguments.csv}\n')
        if arguments.video:
            frames = export_video(reader, arguments.video, scale=arguments.scale,
                                  speed=arguments.speed, **choice)
            sys.stdout.write(f'{frames} frames in {arguments.video}\n')
    return 0


COMMANDS = {
    'record': _record, 'play': _play, 'info': _info, 'verify': _verify, 'recover': _recover,
    'export': _export,
}


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
    result = ['--ros-args']
    for name, text in values.items():
        value = parse_text(settings_class, name, text)
        # rcl reads parameter values as YAML; JSON is YAML that leaves no doubt about a text
        result += ['-p', f'{name}:={json.dumps(value)}']
    return result


__all__ = ['add_arguments', 'BagError', 'main']
