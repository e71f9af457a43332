# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes as children: how they start, how each kind of end is told, and who waits for whom."""
import importlib
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import textwrap
import time
import types

from carracing_dqn.bringup import supervise
from carracing_dqn.bringup.graph import (
    ANNOTATOR, cars_graph, driving_graph, KINDS, race_graph, REFEREE, replay_graph, TELEOP,
    training_graph,
)
from carracing_dqn.bringup.launch_graph import _end_all, NodeFailed
from carracing_dqn.bringup.processes import ChildDied, node_command, ProcessGroup
from graph_probe import carracing, wait_for
from msgs_bridge.errors import BridgeError
from msgs_bridge.exit_codes import ERROR, FINISHED, INTERRUPTED
from msgs_bridge.node_process import FINISHED_TO
from msgs_bridge.settings import describe
import pytest
from trainer_node.hyperparameters import Hyperparameters


@pytest.fixture
def group(tmp_path, monkeypatch):
    """Processes whose modules lie in a folder of the test."""
    monkeypatch.setenv('PYTHONPATH', str(tmp_path))
    (tmp_path / 'log').mkdir()
    with ProcessGroup(tmp_path / 'log') as group:
        yield group


def start(group, name, code, *, keeps=False, words=(), **options):
    """Start a module that holds a `main` of some lines."""
    body = textwrap.indent(textwrap.dedent(code).strip(), '    ')
    path = group.log_folder.parent / f'{name}.py'
    path.write_text(f'import os, signal, sys, time\ndef main():\n{body}\n')
    command = node_command(name, {}, **{'supervised': True, **options})
    return group.start(name, [*command, *words], keeps=keeps)


def test_a_folder_may_begin_with_a_dash(group, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path('-x').mkdir()
    child = start(group, 'here', 'print(os.getcwd(), flush=True)', folder='-x')
    assert child.process.wait(30) == 0
    child._reader.join()
    assert list(child.words) == [str(tmp_path / '-x')]


def test_two_commands_that_start_at_once_do_not_drive_in_one_namespace(tmp_path, monkeypatch):
    monkeypatch.setenv('TMPDIR', str(tmp_path))
    monkeypatch.setattr(tempfile, 'tempdir', None)
    other = subprocess.Popen([sys.executable, '-c', (
        'from carracing_dqn.bringup import supervise\n'
        "supervise._take_place('/one/')\nprint('taken', flush=True)\ninput()\n"
        "supervise._leave_places()\nprint('left', flush=True)\ninput()")],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        assert other.stdout.readline() == 'taken\n'
        with pytest.raises(BridgeError, match='runs on this ROS domain already'):
            supervise._take_place('/one')
        supervise._take_place('/two')
        supervise._take_place('/two')
        other.stdin.write('\n')
        other.stdin.flush()
        assert other.stdout.readline() == 'left\n'
        supervise._take_place('/one')
    finally:
        supervise._leave_places()
        other.kill()
        other.communicate()


def test_a_log_that_is_a_fifo_is_not_waited_for(group):
    os.mkfifo(group.log_folder / 'stuck.log')
    with pytest.raises(BridgeError, match='stuck cannot be started'):
        start(group, 'stuck', 'return 0')


def waits(graph):
    return {node.kind.role: node.parameters.get('wait_for_subscribers') for node in graph}


def test_simulator_and_policy_wait_for_everybody_who_must_miss_nothing():
    assert waits(driving_graph(model='racing', seed=1)) == {'policy': 1, 'simulator': 0}
    assert waits(driving_graph(model='racing', seed=1, bag='bag')) == {
        'recorder': None, 'policy': 2, 'simulator': 1}
    settings = Hyperparameters()
    assert waits(training_graph(settings, trainer={})) == {
        'trainer': None, 'policy': 2, 'validator': None, 'simulator': 1}
    assert waits(training_graph(settings, trainer={}, bag='bag')) == {
        'recorder': None, 'trainer': None, 'policy': 3, 'validator': None, 'simulator': 2}
    assert [node.kind.name for node in replay_graph(bag='x')] == ['bag_player_node']


def test_cars_are_apart_wait_for_all_that_hear_them_and_take_the_weights_of_one():
    graph = cars_graph(Hyperparameters(), 2, trainer={}, bag='bag', namespace='race',
                       episodes={'/race/car_1': 7})
    roles = [node.role for node in graph]
    assert roles == ['recorder', 'trainer', 'validator', 'policy_car_0', 'simulator_car_0',
                     'policy_car_1', 'simulator_car_1']
    nodes = dict(zip(roles, graph))
    assert waits(graph)['policy'] == 3 and waits(graph)['simulator'] == 2
    policies, simulators = ([nodes[f'{role}_car_{car}'] for car in (0, 1)]
                            for role in ('policy', 'simulator'))
    for namespace, weights in (
            ('', '/weights'), ('race', '/race/weights'), ('/a/b', '/a/b/weights')):
        assert policies[0].remaps(namespace) == {'weights': weights}
    assert policies[1].namespace('race') == 'race/car_1' == simulators[1].namespace('/race')
    assert nodes['trainer'].parameters['sources'] == 'car_*' and not nodes['trainer'].space
    assert [one.parameters['epsilon_exponent'] for one in policies] == [1.0, 8.0]
    assert [one.parameters['first_episode'] for one in simulators] == [0, 7]
    assert not any(one.parameters['publish_clock'] for one in simulators)
    for kind in (policies, simulators):
        assert kind[0].parameters['seed'] != kind[1].parameters['seed']
    words = node_command('x', {}, policies[1].namespace('race'),
                         remaps=policies[1].remaps('race'))
    assert words[-4:] == ['-r', '__ns:=/race/car_1', '-r', 'weights:=/race/weights']


def test_a_car_that_dies_does_not_end_the_others_but_the_last_one_does(tmp_path):
    with ProcessGroup(tmp_path) as group:
        for name in ('simulator_car_0', 'policy_car_0', 'simulator_car_1'):
            group.start(name, ['sleep', '60'], expendable=True)
        assert group.check() is None and group.losses() == []
        group.children['simulator_car_0'].process.kill()
        group.children['simulator_car_0'].process.wait()
        assert group.check() is None
        (line,) = group.losses()
        assert 'simulator_car_0 ended with signal SIGKILL' in line and 'go on' in line
        assert group.losses() == []
        group.children['simulator_car_1'].process.kill()
        group.children['simulator_car_1'].process.wait()
        with pytest.raises(ChildDied, match='no car is left: simulator_car_1 ended'):
            group.check()
        group.stop()
        group.check_ends()


def test_a_car_without_its_policy_is_none(tmp_path):
    with ProcessGroup(tmp_path) as group:
        group.start('simulator_car_0', ['sleep', '60'], expendable=True)
        group.start('policy_car_0', ['true'], expendable=True).process.wait(20)
        with pytest.raises(ChildDied, match='no car is left: policy_car_0 ended with exit code 0'):
            group.check()


def test_graphs_name_parameters_that_the_nodes_know():
    graphs = [driving_graph(model='racing', seed=1, bag='bag'), replay_graph(bag='bag'),
              training_graph(Hyperparameters(), trainer={'run': 'x', 'preset': 'y'}),
              race_graph(seed=1, episodes=2, race={'rivals': 'x', 'real_time_factor': 1.0}),
              cars_graph(Hyperparameters(), 2, trainer={'run': 'x', 'preset': 'y'}, bag='bag')]
    seen = set()
    for node in sum(graphs, ()):
        module, name = node.kind.settings.split(':')
        settings = getattr(importlib.import_module(module), name)
        known = describe(settings if isinstance(settings, type) else settings())
        assert node.parameters.keys() <= known.keys(), node.kind.name
        seen.add(node.kind)
    # a robot's referee is started beside it, by hand
    assert seen == {*KINDS} - {ANNOTATOR, REFEREE, TELEOP}


def test_a_child_is_nice_in_its_folder_and_ends_with_its_parent(tmp_path):
    (tmp_path / 'sleeper.py').write_text(
        'import os, time\ndef main():\n'
        '    print(os.getpid(), os.nice(0), os.getcwd(), flush=True)\n    time.sleep(60)\n')
    parent = (
        'import subprocess, sys, time\n'
        'from carracing_dqn.bringup.processes import node_command\n'
        "subprocess.Popen(node_command('sleeper', {}, nice=3, folder='/'))\ntime.sleep(60)\n")
    process = subprocess.Popen(
        [sys.executable, '-c', parent], stdout=subprocess.PIPE, text=True,
        env={**os.environ, 'PYTHONPATH': str(tmp_path)})
    pid, nice, folder = process.stdout.readline().split()
    assert int(nice) == os.nice(0) + 3 and folder == '/'
    process.kill()
    process.wait()
    wait_for(lambda: not Path(f'/proc/{pid}').exists()
             or ') Z ' in Path(f'/proc/{pid}/stat').read_text(), 10, 'the end of the child')


def test_finished_work_has_a_code_and_anything_else_is_told_with_its_cause(group):
    start(group, 'done', f'return {FINISHED}')
    wait_for(lambda: group.check() == 'done', 20, 'the end')
    start(group, 'failing', "print('error: the disk is full'); print('bye'); return 2")
    with pytest.raises(ChildDied, match='failing ended with exit code 2: the disk is full .log: '):
        wait_for(lambda: group.check() == 'failing', 20, 'the end')


def test_a_child_that_ends_well_of_itself_has_not_finished(group):
    child = start(group, 'silent', 'os._exit(0)')
    child.process.wait(20)
    with pytest.raises(ChildDied, match='^silent ended with exit code 0 before its work was done'):
        group.check()
    group.stop()
    # nor has one that should save
    with pytest.raises(ChildDied, match='^silent ended with exit code 0 before its work was done'):
        group.check_ends()


def test_a_library_that_ends_the_simulator_does_not_make_the_drive_a_success(tmp_path):
    (tmp_path / 'leaving.py').write_text(textwrap.dedent("""
        import os
        import toy_simulator

        class Leaving(toy_simulator.Toy):
            steps = 0

            def advance(self, command, frames=1):
                self.steps += 1
                if self.steps > 60:
                    os._exit(0)
                return super().advance(command, frames)
        """))
    done = carracing(
        'run', '--model', 'random', '--simulator', 'leaving:Leaving', '--laps', '100', '--no-bag',
        '--output', str(tmp_path / 'drive'), timeout=90,
        env={**os.environ, 'PYTHONPATH': os.pathsep.join((str(tmp_path), 'tests'))})
    assert done.returncode == ERROR, done.stdout + done.stderr
    assert done.stderr.startswith(
        'error: simulator ended with exit code 0 before its work was done (log: ')
    assert done.stderr.count('\n') == 1


NODE = """
import dataclasses
from msgs_bridge.node_shell import Finished, NodeShell, run_node

@dataclasses.dataclass(frozen=True)
class Settings:
    pass

class Node(NodeShell):
    def __init__(self):
        super().__init__('made_up', Settings)
        with open('open', 'w'):
            print('opened', flush=True)
        {makes}

    def finish(self):
        raise Finished

    def close(self):
        print('closed', flush=True)

def main():
    return run_node(Node)
"""


def start_node(group, makes):
    """Start a node whose constructor goes on with some lines."""
    folder = group.log_folder.parent
    makes = textwrap.indent(textwrap.dedent(makes).strip(), 8 * ' ').strip()
    (folder / 'made_up.py').write_text(NODE.replace('{makes}', makes))
    return group.start('made_up', node_command('made_up', {}, supervised=True, folder=folder))


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_waits_for_a_node_that_is_being_made_and_then_closes_it(group, number):
    child = start_node(group, """
        import time
        for _ in range(50):
            time.sleep(0.02)
            self.count_publishers('image_raw')
        print('made', flush=True)""")
    wait_for(lambda: child.said('opened'), 20, 'it')
    child.process.send_signal(number)
    assert child.process.wait(20) == INTERRUPTED
    wait_for(lambda: child.said('closed'), 5, 'its last word')
    assert list(child.words) == ['opened', 'made', 'closed']


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_node_that_is_never_made_ends_all_the_same(group, number):
    child = start_node(group, 'import threading; threading.Event().wait()')
    wait_for(lambda: child.said('opened'), 20, 'it')
    child.process.send_signal(number)
    assert child.process.wait(30) == ERROR
    assert 'told to end, and still starting 10 s later' in child.obituary()


def test_a_launch_believes_a_node_that_its_work_is_done_and_nobody_else(group, monkeypatch):
    finished, writer = os.pipe()
    os.set_blocking(finished, False)
    monkeypatch.setenv(FINISHED_TO, f'/proc/{os.getpid()}/fd/{writer}')
    child = start_node(group, 'self.create_timer(0.1, self.finish)')
    assert child.process.wait(20) == FINISHED
    actions = types.SimpleNamespace(EmitEvent=lambda event: event)
    events = types.SimpleNamespace(Shutdown=lambda reason: reason)
    for name, module in (('actions', actions), ('events', events)):
        monkeypatch.setitem(sys.modules, f'launch.{name}', module)
    monkeypatch.setitem(sys.modules, 'launch', types.ModuleType('launch'))
    event = types.SimpleNamespace(process_name='made_up-1', returncode=0, pid=child.process.pid)
    running = types.SimpleNamespace(is_shutdown=False)
    assert _end_all(finished, event, running) == 'made_up-1 is done'
    with pytest.raises(NodeFailed, match='made_up-1 ended with code 0 before its work was done'):
        _end_all(finished, event, running)
    os.close(finished)
    os.close(writer)


def test_a_child_that_was_stopped_from_outside_has_not_finished(group):
    child = start(group, 'stopped', f'time.sleep(0.2); return {INTERRUPTED}')
    child.process.wait(20)
    with pytest.raises(ChildDied, match='stopped was stopped from outside before the work'):
        group.check()


def test_what_was_said_before_a_signal_is_no_cause(group):
    child = start(group, 'shot', "print('all is well', flush=True); os.kill(os.getpid(), 9)")
    child.process.wait(20)
    with pytest.raises(ChildDied, match='^shot ended with signal SIGKILL .log: '):
        group.check()


def test_a_traceback_is_told_by_its_last_line_without_escapes(group):
    child = start(group, 'odd', "raise ValueError('\\x1b[31m' + 'x' * 5000)")
    child.process.wait(20)
    with pytest.raises(ChildDied, match='odd ended with exit code 1: ValueError: ') as found:
        group.check()
    assert str(found.value).isprintable() and len(str(found.value)) < 600


def test_a_folder_that_is_gone_and_a_log_that_cannot_be_had_are_told(group, tmp_path):
    start(group, 'sleeping', 'time.sleep(60)')
    (tmp_path / 'log' / 'sleeping.log').unlink()
    (tmp_path / 'log').rmdir()
    with pytest.raises(BridgeError, match='was removed while it was written to'):
        group.check()
    with pytest.raises(BridgeError, match='late cannot be started'):
        start(group, 'late', 'pass')


def test_a_full_disk_does_not_stand_in_the_way_of_a_child(group, monkeypatch):
    (group.log_folder / 'loud.log').symlink_to('/dev/full')
    child = start(group, 'loud', "for _ in range(20000): print('x' * 100)\nreturn 0")
    assert child.process.wait(30) == 0


def test_those_that_save_have_time_and_others_are_killed_without_a_word(group):
    stubborn = start(group, 'stubborn', """
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        print('up', flush=True)
        time.sleep(60)""")
    saving = start(group, 'saving', f"""
        def save(*_):
            time.sleep(4)
            print('saved', flush=True)
            sys.exit({INTERRUPTED})
        signal.signal(signal.SIGINT, save)
        print('up', flush=True)
        time.sleep(60)""", keeps=True)
    wait_for(lambda: stubborn.said('up') and saving.said('up'), 20, 'both')
    group.stop()
    group.check_ends()
    assert stubborn.code == -signal.SIGKILL and saving.code == INTERRUPTED and saving.said('saved')


def test_a_child_that_could_not_save_is_told_after_the_stop(group):
    child = start(group, 'recorder', """
        def fail(*_):
            print('error: the bag could not be completed', flush=True)
            sys.exit(2)
        signal.signal(signal.SIGINT, fail)
        print('up', flush=True)
        time.sleep(60)""", keeps=True)
    wait_for(lambda: child.said('up'), 20, 'it')
    group.stop()
    with pytest.raises(ChildDied, match='exit code 2: the bag could not be completed'):
        group.check_ends()


def test_a_child_that_is_stopped_while_it_imports_says_nothing(group):
    path = group.log_folder.parent / 'slow.py'
    path.write_text('print("importing", flush=True)\nimport time\ntime.sleep(60)\n'
                    'def main(): pass\n')
    child = group.start('slow', node_command('slow', {}, supervised=True))
    wait_for(lambda: child.said('importing'), 20, 'it')
    began = time.monotonic()
    group.stop()
    group.check_ends()
    assert time.monotonic() - began < 10
    assert list(child.words) == ['importing']


def test_a_child_that_is_stopped_as_soon_as_it_starts_says_nothing(group):
    """Python's own start would answer with a traceback."""
    children = []
    for number in range(12):
        child = group.start(f'early{number}', node_command('dqn_policy_node', {}, supervised=True))
        children.append(child)
        time.sleep(number * 0.004)
        child.process.send_signal(signal.SIGINT)
    for child in children:
        assert child.process.wait(30) == -signal.SIGINT
    wait_for(lambda: all(child.code is not None for child in children), 10, 'their ends')
    assert [list(child.words) for child in children] == [[]] * len(children)


def test_signals_wait_until_all_are_stopped(group):
    child = start(group, 'slow_to_end', f"""
        def end(*_):
            time.sleep(1)
            sys.exit({INTERRUPTED})
        signal.signal(signal.SIGINT, end)
        print('up', flush=True)
        time.sleep(60)""", keeps=True)
    wait_for(lambda: child.said('up'), 20, 'it')
    subprocess.Popen(['sh', '-c', f'sleep 0.3; kill -INT {os.getpid()}'])
    group.stop()
    assert child.code == INTERRUPTED
