# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Ten faulty graphs of real nodes, for `carracing watch` to name.

`PYTHONPATH=tests python -m watch_faults NAME` prepares one in the current ROS domain and keeps it
until Ctrl-C; without a name it takes one by chance and says at the end which it was.
"""
from collections.abc import Callable
import contextlib
import os
from pathlib import Path
import random
import resource
import signal
import sys
import tempfile
import time
from typing import NamedTuple

from carracing_dqn.bringup.processes import Child, node_command
from faults.running_graph import PRESET
from graph_probe import Graph, wait_for
import yaml

TESTS = Path(__file__).resolve().parent
START_SECONDS = 90
# so that a watch has seen it well
WELL_SECONDS = 8.0


class Fault(NamedTuple):
    """
    A fault that can be prepared.

    Attributes:
        prepare: starts the nodes of a graph and breaks something.
        kinds: what `causes` may call it, the first best.
        where: the end of the name of the node or topic that is to blame.
    """

    prepare: Callable[[Graph], None]
    kinds: tuple[str, ...]
    where: str


def start(graph: Graph, name: str, module: str, *remaps: str, **parameters: object) -> Child:
    """Start a node with remaps."""
    command = node_command(module, parameters, graph.namespace)
    for remap in remaps:
        command += ['-r', remap]
    return graph.start(name, command)


def simulator(graph: Graph, *remaps: str, **parameters: object) -> Child:
    """Start CarRacing at half its pace, so that several fit on a machine."""
    return start(graph, 'simulator', 'carracing_sim_node', *remaps, **{
        'stepping': 'real_time', 'real_time_factor': 0.5, 'action_repeat': 2, 'stale_after': 5.0,
        **parameters})


def policy(graph: Graph, *remaps: str, model: str = 'random', **parameters: object) -> Child:
    """Start a policy."""
    return start(graph, 'policy', 'dqn_policy_node', *remaps, model=model, **parameters)


def trainer(graph: Graph, *remaps: str, **recipe: object) -> Child:
    """Start a trainer with a small network."""
    preset = graph.log_folder / 'tiny.yaml'
    preset.write_text(yaml.safe_dump({**PRESET, 'action_repeat': 2, **recipe}))
    return start(graph, 'trainer', 'trainer_node', *remaps,
                 preset=str(preset), run=str(graph.log_folder / 'run'))


def recorder(graph: Graph) -> Child:
    """Start simulator, policy and recorder, and wait until it has recorded for a while."""
    child = start(graph, 'recorder', 'bags.recorder_node', folder=str(graph.log_folder / 'bag'))
    policy(graph)
    simulator(graph, wait_for_subscribers=1)
    wait_for(lambda: child.said('recording '), START_SECONDS, 'the recorder records')
    time.sleep(WELL_SECONDS)
    return child


def wrong_remap(graph: Graph) -> None:
    """The policy listens where no camera is."""
    policy(graph, 'image_raw:=camera/image')
    simulator(graph)


def best_effort_camera(graph: Graph) -> None:
    """The camera offers less than the policy was told to ask for."""
    topic = f'/{graph.namespace}/image_raw'
    policy(graph, **{f'qos_overrides.{topic}.subscription.reliability': 'reliable'})
    simulator(graph, **{f'qos_overrides.{topic}.publisher.reliability': 'best_effort'})


def plain_twist(graph: Graph) -> None:
    """The policy sends twists without a stamp, the simulator wants them with one."""
    policy(graph, cmd_vel_stamped=False)
    simulator(graph)


def stale_weights(graph: Graph) -> None:
    """The policy takes no weights from the trainer."""
    # of the same actions as the model, so that this is all that is wrong
    trainer(graph, action_space='grid9')
    policy(graph, model='racing', hot_swap=False)
    simulator(graph)


def swapped_colours(graph: Graph) -> None:
    """The camera calls bgr rgb."""
    os.environ['PYTHONPATH'] = os.pathsep.join(
        filter(None, (str(TESTS), os.environ.get('PYTHONPATH'))))
    policy(graph)
    start(graph, 'camera', 'colour_swapper')
    simulator(graph, 'image_raw:=true_colours')


def half_rate(graph: Graph) -> None:
    """The simulator shows every fourth frame, the model wants every second."""
    policy(graph, model='racing')
    simulator(graph, action_repeat=4)


def mirrored_steering(graph: Graph) -> None:
    """The policy turns right when it means left."""
    policy(graph, model='racing', angular_scale=-1.0)
    simulator(graph)


def dead_recorder(graph: Graph) -> None:
    """The recorder is killed."""
    recorder(graph).signal(signal.SIGKILL)


def full_disk(graph: Graph) -> None:
    """No file of the recorder may grow any more, which says what a full disk says."""
    limits = resource.prlimit(recorder(graph).process.pid, resource.RLIMIT_FSIZE)
    resource.prlimit(graph.children['recorder'].process.pid, resource.RLIMIT_FSIZE,
                     (0, limits[1]))


def silent_trainer(graph: Graph) -> None:
    """The trainer hears no step, and so learns nothing."""
    trainer(graph, 'step:=nowhere/step')
    policy(graph)
    simulator(graph)


FAULTS = {
    'wrong remap': Fault(wrong_remap, ('wrong remap',), '/camera/image'),
    'best-effort camera': Fault(best_effort_camera, ('best effort',), '/image_raw'),
    'plain Twist': Fault(plain_twist, ('plain twist',), '/cmd_vel'),
    'stale weights': Fault(stale_weights, ('stale weights',), '/dqn_policy_node'),
    'swapped colours': Fault(swapped_colours, ('swapped colours',), '/image_raw'),
    'half rate': Fault(half_rate, ('low rate',), '/carracing_sim_node'),
    'mirrored steering': Fault(mirrored_steering, ('mirrored steering',), '/dqn_policy_node'),
    'dead recorder': Fault(
        dead_recorder, ('node silent', 'node gone'), '/bag_recorder_node'),
    'full disk': Fault(full_disk, ('full disk',), '/bag_recorder_node'),
    'silent trainer': Fault(silent_trainer, ('silent trainer',), '/trainer_node'),
}


def main() -> None:
    """Prepare a fault and keep it."""
    name = sys.argv[1] if len(sys.argv) > 1 else random.choice(list(FAULTS))
    with contextlib.suppress(KeyboardInterrupt), tempfile.TemporaryDirectory() as folder, Graph(
            Path(folder), 'faulty') as graph:
        FAULTS[name].prepare(graph)
        sys.stdout.write('prepared; Ctrl-C ends it\n')
        sys.stdout.flush()
        while True:
            graph.spin(1.0)
    sys.stdout.write(f'it was: {name}\n')


if __name__ == '__main__':
    main()
