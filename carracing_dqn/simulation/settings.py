# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of a simulator node, each described once; the simulator's own come on top."""
from __future__ import annotations

from collections.abc import Mapping
import dataclasses
import functools
from types import MappingProxyType

from carracing_dqn.simulation.checks import blamed
from carracing_dqn.simulation.registry import DEFAULT, find_simulator
from msgs_bridge.errors import SettingsError
from msgs_bridge.settings import check_value, describe, setting


@dataclasses.dataclass(frozen=True)
class SimulationSettings:
    """What can be set on the node of any simulator."""

    simulator: str = setting(
        DEFAULT, 'which simulator: the name of an installed one, or module:Class')
    stepping: str = setting(
        'lockstep', 'lockstep waits for the twist that answers each frame; real_time runs by the '
        'wall clock and holds the last twist', choices=('lockstep', 'real_time'))
    action_repeat: int = setting(
        1, 'simulated frames per published frame; one twist drives all of them', low=1, high=50)
    seed: int = setting(
        42, 'seed of the first episode (seed document 3.1: 42 training, 420 validation)',
        low=0, high=2**31 - 1)
    seed_each_episode: bool = setting(
        False, 'true: episode n has the seed seed + n; false: seed once, then the stream '
        'that follows, as gymnasium does')
    track_retries: int = setting(
        0, 'with seed_each_episode: how often a track is driven again at once on which the return '
        'was among the lowest tenth of the last 100, for training', low=0, high=100)
    first_episode: int = setting(
        0, 'number of the first episode; earlier ones are passed over, for resuming',
        low=0, high=10**9)
    episodes: int = setting(
        0, 'episodes to drive before the node ends; 0 = no end', low=0, high=10**9)
    answer_timeout: float = setting(
        1.0, 'lockstep: seconds of wall time to wait for a twist before on_timeout; longer than '
        'the driver takes', low=0.01, high=3600.0, live=True)
    on_timeout: str = setting(
        'resend', 'lockstep, nobody answered: send the same frame again, or go on and coast, '
        'or go on and hold the last twist', choices=('resend', 'coast', 'hold'), live=True)
    real_time_factor: float = setting(
        1.0, 'real_time: speed against the wall clock', low=0.01, high=100.0)
    stale_after: float = setting(
        0.25, 'real_time: seconds of wall time after which a held twist becomes zero',
        low=0.01, high=60.0, live=True)
    cmd_vel_stamped: bool = setting(
        True, 'false: cmd_vel is a plain Twist; in lockstep it answers the newest frame, and '
        'each image has to be answered once')
    wait_for_subscribers: int = setting(
        0, "subscriptions of image_raw and step, beside the policy's, to wait for before the "
        'first frame, so that trainer and recorder miss nothing',
        low=0, high=100)
    start_paused: bool = setting(False, 'wait for ~/pause false or ~/step')
    publish_clock: bool = setting(
        True, 'publish /clock, unless another node publishes it already; false: never')
    image_compressed: bool = setting(
        False, 'true: image_raw is a CompressedImage, png without loss: a ninth of the bytes of '
        'CarRacing for half a millisecond; drivers need camera_compressed')
    frame_id: str = setting('camera', 'frame_id of the images')


@functools.cache
def settings_for(simulator: str) -> type:
    """
    Return the settings class of the node of a simulator: the node's settings and its own.

    Instances are of both classes.

    Raises:
        SimulatorError: there is no such simulator.
        SettingsError: it has a setting of the node's name and another type.
    """
    own = find_simulator(simulator).Settings
    shared = describe(SimulationSettings)
    for name, (kind, _, _) in describe(own).items():
        if name in shared and (name == 'simulator' or kind is not shared[name][0]):
            raise SettingsError(
                f"simulator {simulator!r} has a setting {name!r} that is not the node's")
    # what the node is without a word is this simulator
    default = ('simulator', str, dataclasses.field(
        default=simulator, metadata={'description': shared['simulator'][2]}))

    def check_itself(settings: object) -> None:
        """Let the simulator's settings check themselves, where they do; raises BridgeErrors."""
        check = getattr(super(made, settings), '__post_init__', None)
        if check is not None:
            with blamed(simulator, 'Settings'):
                check()

    made = dataclasses.make_dataclass(
        'NodeSettings', [default], bases=(own, SimulationSettings), frozen=True,
        namespace={'__post_init__': check_itself})
    return made


def node_settings(
    values: Mapping[str, object] = MappingProxyType({}), simulator: str = DEFAULT,
) -> type:
    """
    Return the settings class that fits the parameters that were given.

    Args:
        values: the parameters.
        simulator: which one it is if they do not say.

    Raises:
        SimulatorError, SettingsError: as `settings_for`.
    """
    kind, _, description = describe(SimulationSettings)['simulator']
    return settings_for(check_value('simulator', kind, description,
                                    values.get('simulator', simulator)))
