# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
What is wrong with a graph, each with its cause and what mends it.

Each judge is a function of the state and the time that yields what it has found; `JUDGES` lists
them, worst first. To know another fault is to add a function.
"""
from __future__ import annotations

from collections.abc import Callable, Iterator
import math
from typing import Any, NamedTuple, TYPE_CHECKING

import numpy as np

from carracing_dqn.watch.car import Car, IMAGE_TYPES, TWIST_TYPES
from carracing_dqn.watch.graph_parts import End, Node
from msgs_bridge.health import ERROR, WARN
from msgs_bridge.images import ENCODINGS
from msgs_bridge.plain_text import plain
from msgs_bridge.topics import CMD_VEL, IMAGE

if TYPE_CHECKING:
    from carracing_dqn.watch.state import WatchState

MOST_CAUSES = 30
MAX_REASON = 200
# how much longer than a model holds an action the next image may come
RATE_TOLERANCE = 0.15
# colours of a part of the picture that are nearer than this are the same, of 255
COLOUR_TOLERANCE = 40.0
# weights that are behind for so long are stale, a trainer that takes nothing for so long is silent
STALE_SECONDS, IDLE_SECONDS = 6.0, 6.0
# of what a disk says when it takes no more
DISK_WORDS = ('No space left', 'File too large', 'Disk quota', 'the disk has taken nothing')
# nodes that subscribe to everything and miss nothing by it
RECORDERS = ('bag_recorder_node', 'rosbag2_recorder')
RECOVER = '`carracing bag recover` saves what its bag holds'


class Cause(NamedTuple):
    """
    One thing that is wrong.

    Attributes:
        kind: which fault, in one or two words; the same for all of its kind.
        where: the node or topic.
        text: what is wrong.
        mend: what mends it, '' if that is not known.
    """

    kind: str
    where: str
    text: str
    mend: str = ''


def causes(state: WatchState, now: float) -> list[Cause]:
    """Return what is wrong, worst first, each once."""
    found: dict[tuple[str, str], Cause] = {}
    for judge in JUDGES:
        for cause in _judged(judge, state, now):
            if any(cause.text in other.text for other in found.values()
                   if other.where == cause.where):
                # a judge before has said it, and what it means
                continue
            found.setdefault((cause.kind, cause.where), cause)
            if len(found) >= MOST_CAUSES:
                return list(found.values())
    return list(found.values())


def _judged(
    judge: Callable[[WatchState, float], Iterator[Cause]], state: WatchState, now: float,
) -> list[Cause]:
    """Return what a judge finds; one that fails is told of, and the others go on."""
    try:
        return list(judge(state, now))
    except Exception as error:
        # all that it looks at came over a wire
        return [Cause('watch', judge.__name__.strip('_'), plain(
            f'this look at the graph failed: {type(error).__name__}: {error}', MAX_REASON))]


def _disk(state: WatchState, now: float) -> Iterator[Cause]:
    for node in state.nodes.values():
        if any(word in node.worst for word in DISK_WORDS):
            room = ('a higher limit of the size of files (ulimit -f)'
                    if 'File too large' in node.worst else 'room on the disk')
            yield Cause('full disk', node.name, node.worst,
                        f'{room}, then start it again; {RECOVER}' if _base(
                            node.name) in RECORDERS else f'{room}, then go on with --resume')


def _gone(state: WatchState, now: float) -> Iterator[Cause]:
    """Find nodes that are no more while others of their namespace run."""
    states = {name: state.node_state(node, now) for name, node in state.nodes.items()}
    alive = {name.rpartition('/')[0] for name, one in states.items() if one == 'running'}
    for name, one in states.items():
        node = state.nodes[name]
        if one == 'gone' and node.heard_at is not None and name.rpartition('/')[0] in alive:
            said = node.worst or node.summary
            yield Cause('node gone', name, f'it is gone; it said last: {said}',
                        'its log tells why; start it again' + (
                            f'; {RECOVER}' if _base(name) in RECORDERS else ''))
        elif one == 'silent':
            yield Cause('node silent', name,
                        f'it has said nothing for {now - node.heard_at:.0f} s; it said last: '
                        f'{node.worst or node.summary}',
                        'it was killed, hangs or is stopped: look at its log, start it again')


def _missing(state: WatchState, now: float) -> Iterator[Cause]:
    """Find simulators whose listeners, for whom they once waited, are fewer now."""
    for name, values in state.parameters.items():
        wanted = values.get('wait_for_subscribers')
        topic = state.topics.get(f'{name.rpartition("/")[0]}/step')
        node = state.nodes.get(name)
        if not (type(wanted) is int and wanted > 0 and topic and node and node.was_ok):
            continue
        if not any(end.node == name for end in topic.ends.publishers):
            continue
        there = len({end.node for end in topic.ends.subscriptions})
        if there < wanted:
            yield Cause('listener gone', topic.name,
                        f'{name} was told to wait for {wanted} subscribed (trainer, recorder), '
                        f'there are {there}', 'start the trainer or recorder that is missing')


def _errors(state: WatchState, now: float) -> Iterator[Cause]:
    for node in state.nodes.values():
        if node.heard_at is not None and node.level >= ERROR and (
                state.node_state(node, now) == 'running'):
            yield Cause('error', node.name, node.summary)


def _misfits(state: WatchState, now: float) -> Iterator[Cause]:
    for topic in state.topics.values():
        for misfit in topic.ends.misfits:
            pair = f'{misfit.publisher} -> {misfit.subscription}: {misfit.reason}'
            if misfit.kind == 'QoS':
                best_effort = any(not end.reliable for end in topic.ends.publishers
                                  if end.node == misfit.publisher)
                yield Cause(
                    'best effort' if best_effort else 'QoS', topic.name, pair,
                    f'-p qos_overrides.{topic.name}.subscription.reliability:=best_effort at '
                    f'{misfit.subscription}' if best_effort else
                    f'the QoS of one of them, qos_overrides.{topic.name}.*')
            elif set(TWIST_TYPES) <= {end.type_name for end in (
                    *topic.ends.publishers, *topic.ends.subscriptions)}:
                yield Cause('plain twist', topic.name, pair,
                            'cmd_vel_stamped has to be the same at both: false for Twist, true '
                            'for TwistStamped')
            else:
                yield Cause('type', topic.name, pair, 'one type at both, or another topic')


def _remaps(state: WatchState, now: float) -> Iterator[Cause]:
    """Find a subscription that nobody serves beside a topic of its type that nobody hears."""
    unheard = {name: topic for name, topic in state.topics.items()
               if topic.ends.publishers and not _hearers(topic)}
    for name, topic in state.topics.items():
        ends = topic.ends
        hearers = _hearers(topic)
        if ends.publishers or not hearers:
            continue
        for other, offered in unheard.items():
            if offered.ends.type_name in {end.type_name for end in hearers} and (
                    _camera_or_twist(offered.ends.type_name)
                    or _base(name) == _base(other)):
                yield Cause(
                    'wrong remap', name,
                    f'{hearers[0].node} listens to {name}, which nobody publishes; nobody hears '
                    f'{other} of {offered.ends.publishers[0].node}',
                    f'-r {_own_name(state, hearers[0], name)}:={other} at {hearers[0].node}')
                break


def _base(name: str) -> str:
    return name.rpartition('/')[2]


def _own_name(state: WatchState, end: End, name: str) -> str:
    """Return what a node itself calls a topic, before any remap, as far as that is known."""
    node = state.nodes.get(end.node)
    if node is not None and (node.is_policy or node.is_simulator or node.is_trainer):
        for topic, types in ((IMAGE, IMAGE_TYPES), (CMD_VEL, TWIST_TYPES)):
            if end.type_name in types:
                return topic.name
    return _base(name)


def _camera_or_twist(type_name: str) -> bool:
    return type_name in TWIST_TYPES or type_name.endswith('Image')


def _hearers(topic: Any) -> list[Any]:
    return [end for end in topic.ends.subscriptions if _base(end.node) not in RECORDERS]


def _pairs(state: WatchState) -> Iterator[tuple[Car, Node | None, Node | None, dict]]:
    """Yield each car with its policy, its simulator and the policy's parameters."""
    for space, car in state.cars.items():
        ours = [node for name, node in state.nodes.items() if name.rpartition('/')[0] == space]
        policy = next((node for node in ours if node.is_policy), None)
        simulator = next((node for node in ours if node.is_simulator), None)
        yield car, policy, simulator, dict(
            state.parameters.get(policy.name, {}) if policy else {})


def _colours(state: WatchState, now: float) -> Iterator[Cause]:
    for car, policy, _, parameters in _pairs(state):
        evidence = car.evidence
        seen, told = evidence.patch_rgb, car.camera.get('patch_rgb')
        exchanged = False
        if seen is not None and told:
            apart, apart_if = (np.abs(one - told).max() for one in (seen, seen[::-1]))
            exchanged = apart_if < apart and apart > COLOUR_TOLERANCE
        said = evidence.encodings[-1] if evidence.encodings else ''
        forced = plain(parameters.get('camera_encoding') or said)
        read_otherwise = {said, forced} <= ENCODINGS.keys() and (
            ENCODINGS[said].rgb != ENCODINGS[forced].rgb)
        where = policy.name if policy else f'{car.namespace}/image_raw'
        if exchanged and not read_otherwise:
            yield Cause('swapped colours', f'{car.namespace}/image_raw',
                        f'red and blue are exchanged in the images, which say {said}',
                        f'-p camera_encoding:={"bgr8" if said == "rgb8" else "rgb8"} at {where}, '
                        'or a camera that says what it sends')
        elif read_otherwise and seen is not None and told and not exchanged:
            yield Cause('swapped colours', where,
                        f'images that say {said} are read as {forced}, and say it rightly',
                        f"-p camera_encoding:='' at {where}")


def _steering(state: WatchState, now: float) -> Iterator[Cause]:
    for car, policy, simulator, parameters in _pairs(state):
        scale = parameters.get('angular_scale')
        if simulator is not None and isinstance(scale, float) and scale < 0:
            yield Cause('mirrored steering', policy.name,
                        f'angular_scale is {scale:g}, and {simulator.name} turns left at '
                        'angular.z above 0', f'-p angular_scale:={-scale:g} at {policy.name}')
        elif simulator is not None and parameters.get('camera_mirror') is True:
            yield Cause('mirrored steering', policy.name,
                        'camera_mirror exchanges left and right of pictures that are none of a '
                        'mirror', f'-p camera_mirror:=false at {policy.name}')
        elif car.evidence.mirrored_on_the_way:
            yield Cause('mirrored steering', f'{car.namespace}/cmd_vel',
                        'what is applied has the other sign than what was sent with that stamp',
                        'what stands between them, or angular_scale:=-1')
        elif simulator is None and car.evidence.turns_wrongly:
            yield Cause('mirrored steering', f'{car.namespace}/cmd_vel',
                        'told left, the picture turns right',
                        'angular_scale:=-1, or camera_mirror if it is a mirror image')


def _rate(state: WatchState, now: float) -> Iterator[Cause]:
    for car, policy, simulator, _ in _pairs(state):
        held = policy.number('decision_seconds') if policy else None
        period = car.evidence.period
        if held and period and math.isfinite(held) and period > held * (1 + RATE_TOLERANCE):
            where = simulator.name if simulator else f'{car.namespace}/image_raw'
            yield Cause('low rate', where,
                        f'an image every {period:.3g} s, but the model decides every {held:.3g} '
                        f's: {held / period:.0%} of the rate that it learned at',
                        'action_repeat of the simulator, the rate of the camera, or a model that '
                        'learned at this one')


def _weights(state: WatchState, now: float) -> Iterator[Cause]:
    for car, policy, _, parameters in _pairs(state):
        # as long as it has said with which weights it drives: a silent one is told of by others
        if policy is not None and car.handed_out is not None and (
                policy.heard_at - car.weights_fresh_at > STALE_SECONDS):
            deaf = parameters.get('hot_swap') is False
            said = (f'it drives with version {policy.values["weights_version"]}, the trainer has '
                    f'handed out {car.handed_out:g}')
            yield Cause('stale weights', policy.name,
                        f'hot_swap is false: {said}' if deaf else said,
                        f'-p hot_swap:=true at {policy.name}' if deaf else
                        'what it says of weights, and whether it hears them (nodes, topics)')


def _trainers(state: WatchState, now: float) -> Iterator[Cause]:
    """Find trainers that speak, but learn nothing although a car drives."""
    driving = any(_moves(node) for node in state.nodes.values())
    for name, node in state.nodes.items():
        idle = now - node.progress_at
        if driving and node.is_trainer and idle > IDLE_SECONDS and (
                state.node_state(node, now) == 'running'):
            yield Cause('silent trainer', name, f'it has taken no transition for {idle:.0f} s, '
                        f'and says: {node.summary}',
                        'who publishes what it misses, and its remaps')


def _moves(node: Node) -> bool:
    return node.is_simulator and (node.number('decisions_per_second') or 0.0) > 0


def _warnings(state: WatchState, now: float) -> Iterator[Cause]:
    # who waits for a simulator that a person has paused lacks nothing
    paused = {node.name.rpartition('/')[0] for node in state.nodes.values()
              if node.is_simulator and node.values.get('paused') == 'True'}
    for node in state.nodes.values():
        if node.heard_at is not None and node.level == WARN and (
                state.node_state(node, now) == 'running'
                and not (node.is_policy and node.name.rpartition('/')[0] in paused)):
            yield Cause('warning', node.name, node.summary)


JUDGES = (_disk, _gone, _missing, _errors, _misfits, _remaps, _colours, _steering, _rate,
          _weights, _trainers, _warnings)
