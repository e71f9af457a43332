# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Whatever comes over a topic: taken, or refused by an error of ours with a short text."""
import contextlib
import copy
import dataclasses
import math

from dqn_policy_node.action_space import ACTION_SPACES
from dqn_policy_node.errors import ModelError
from dqn_policy_node.model_description import (
    ModelDescription, Network, parse_convolutions, Preprocessing,
)
from dqn_policy_node.network import QNetwork
from dqn_policy_node.policy import Policy
from dqn_policy_node.weights_message import decode_weights, encode_weights, NewestWeights
from geometry_msgs.msg import Twist
from hypothesis import given, settings, strategies
from msgs_bridge.errors import BridgeError, MessageError
from msgs_bridge.named_values import read_named_values
from msgs_bridge.twists import read_command
import pytest
from sensor_msgs.msg import JointState

DESCRIPTION = ModelDescription(
    Network(parse_convolutions('2@8/8'), 4), Preprocessing(shrink=4), 2,
    ACTION_SPACES['seed5'], 0.08, 0.08)
IMAGE = encode_weights(
    QNetwork(DESCRIPTION).state_dict(), DESCRIPTION, version=3, session='a')
# where the values of the record stand, before the weights
HEADER = IMAGE.index(b'}}') + 2


@settings(max_examples=300, deadline=None)
@given(strategies.lists(strategies.tuples(
    strategies.integers(0, len(IMAGE) - 1), strategies.integers(0, 255)), max_size=4),
    strategies.one_of(strategies.just(len(IMAGE)), strategies.integers(0, len(IMAGE))),
    strategies.binary(max_size=20), strategies.booleans())
def test_a_weights_image_is_whole_or_refused(changes, length, tail, in_header):
    data = bytearray(IMAGE)
    for place, value in changes:
        data[place % HEADER if in_header else place] = value
    data = bytes(data[:length] + tail)
    policy, newest = Policy(DESCRIPTION), NewestWeights()
    try:
        update = decode_weights(data, DESCRIPTION)
        newest.check(update)
        policy.swap_weights(update)
    except ModelError as error:
        assert len(str(error)) < 400
    else:
        # what the hash does not cover is checked value by value
        assert 0 <= policy.epsilon <= 1 and math.isfinite(policy.gas_weight)


ODD = (None, True, -1, 1.5, math.nan, math.inf, 10**400, '', 'x' * 10_000, '\ud800', [], [[]], {},
       {'a': 1}, -0.0, 2**63)


def places(value, path=()):
    """Yield the path of everything in JSON values; of a list its first two."""
    yield path
    inside = value.items() if isinstance(value, dict) else enumerate(value[:2]) if isinstance(
        value, list) else ()
    for key, each in inside:
        yield from places(each, (*path, key))


@pytest.mark.parametrize('space', ['seed5', 'continuous', 'hybrid'])
def test_a_description_with_anything_anywhere_is_taken_or_refused(space):
    description = dataclasses.replace(DESCRIPTION, action_space=ACTION_SPACES[space])
    whole = description.to_json()
    for path in places(whole):
        for odd in ODD:
            changed = copy.deepcopy({'': whole})
            *before, last = ('', *path)
            inner = changed
            for key in before:
                inner = inner[key]
            inner[last] = odd
            with contextlib.suppress(ModelError):
                ModelDescription.from_json(changed[''])


@given(strategies.floats(), strategies.floats())
def test_a_twist_is_finite_or_refused(linear, angular):
    twist = Twist()
    twist.linear.x, twist.angular.z = linear, angular
    try:
        assert all(map(math.isfinite, read_command(twist)))
    except MessageError:
        assert not (math.isfinite(linear) and math.isfinite(angular))


@given(strategies.lists(strategies.text(max_size=20), max_size=6),
       strategies.lists(strategies.floats(), max_size=6))
def test_a_bundle_has_what_is_asked_for_or_is_refused(names, values):
    try:
        read = read_named_values(JointState(name=names, position=values), ['version'])
        assert math.isfinite(read['version'])
    except BridgeError as error:
        assert len(str(error)) < 200
