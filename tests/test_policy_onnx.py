# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A model as ONNX answers in onnxruntime what it answers here."""
import json
from pathlib import Path
import subprocess
import sys

from carracing_dqn.bringup.command import main
from carracing_sim_node import make_env
from carracing_sim_node.controls import controls
from dqn_policy_node.action_space import ACTION_SPACES
from dqn_policy_node.model_description import (
    ModelDescription, Network, parse_convolutions, Preprocessing,
)
from dqn_policy_node.model_folder import load_model, Model, save_model
from dqn_policy_node.network import QNetwork
from dqn_policy_node.policy import Policy
from dqn_policy_node.preprocessing import Preprocessor
from dqn_policy_node.shipped_models import find_model, shipped_models
from dqn_policy_node.weights_message import WeightsUpdate
import numpy as np
import pytest
import torch

onnxruntime = pytest.importorskip('onnxruntime', reason='onnxruntime is not installed')
pytest.importorskip('onnx', reason='onnx is not installed')
from dqn_policy_node.onnx_export import to_onnx, TOLERANCE  # noqa: E402


def session_of(model, name='mine'):
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    return onnxruntime.InferenceSession(
        to_onnx(model, name), options, providers=['CPUExecutionProvider'])


def check(model, stacks):
    """Compare answers to stacks of frames, uint8 (N, stack, H, W, 3)."""
    policy, preprocess = Policy(model.description), Preprocessor(model.description.preprocessing)
    policy.swap_weights(WeightsUpdate(model.tensors, model.description, model.version))
    found, commands = session_of(model).run(None, {'frames': stacks})
    space = model.description.action_space
    for stack, values, command in zip(stacks, found, commands):
        expected = policy.q_values(np.stack([preprocess(frame) for frame in stack]))
        assert values.shape == expected.shape and values.dtype == np.float32
        assert np.all(np.abs(values - expected) <= TOLERANCE * np.maximum(1, np.abs(expected)))
        assert tuple(command) == space.decode(space.greedy(values))


def random_frames(count, own):
    shape = (count, own.frame_stack, own.preprocessing.frame_height,
             own.preprocessing.frame_width, 3)
    return np.random.default_rng(0).integers(0, 256, shape, np.uint8)


@pytest.fixture(scope='module')
def drive():
    """Frames of a lap as the shipped model drives it, uint8 (T, 96, 96, 3)."""
    from dqn_policy_node import load_policy
    env, policy = make_env(), load_policy('racing')
    frames = [env.reset(seed=100_003)[0]]
    while len(frames) < 240:
        frames.append(env.step(controls(policy.act(frames[-1])))[0])
    return np.stack(frames)


@pytest.mark.parametrize('name', shipped_models())
def test_every_shipped_model_answers_alike_on_random_and_on_real_frames(name, drive):
    model = load_model(find_model(name))
    own = model.description
    check(model, random_frames(16, own))
    shrink = drive.shape[1] // own.preprocessing.frame_height
    places = np.arange(4 * own.frame_stack, len(drive), 9)
    stacks = [drive[place - 4 * (own.frame_stack - 1):place + 1:4] for place in places]
    check(model, np.stack(stacks)[:, :, ::shrink, ::shrink])


def test_the_tolerance_is_the_one_that_the_page_states():
    page = (Path(__file__).resolve().parents[1] / 'docs' / 'how_to.md').read_text()
    assert f'within {TOLERANCE:.0e}'.replace('e-0', 'e-') in page


@pytest.mark.parametrize('space', ACTION_SPACES.values(), ids=ACTION_SPACES)
@pytest.mark.parametrize(('network', 'preprocessing'), [
    (Network(parse_convolutions('4@6/3 8@3/2'), 16, True, 0.2),
     Preprocessing(96, 96, 3, 84, 6, 60, 'luma', 'contrast', 3)),
    (Network(parse_convolutions('4@4/4'), 16, quantiles=7), Preprocessing(
        40, 64, rows=40, columns=64, road='flat')),
    (Network(parse_convolutions('4@4/4'), 16, dueling=True, quantiles=5), Preprocessing(
        40, 64, rows=40, columns=64, shrink=2)),
], ids=['luma', 'quantiles', 'dueling quantiles'])
def test_every_kind_of_network_preprocessing_and_actions_answers_alike(
        space, network, preprocessing):
    own = ModelDescription(network, preprocessing, 3, space, 0.1, 0.1)
    torch.manual_seed(1)
    check(Model(own, dict(QNetwork(own).state_dict())), random_frames(12, own))


def test_gray_and_road_are_whole_numbers_equal_to_the_bit():
    """Weights that copy a pixel: its level comes out, for every level of gray."""
    preprocessing = Preprocessing(1, 256, rows=1, columns=256, road='contrast')
    own = ModelDescription(Network(parse_convolutions('1@1/1'), 256), preprocessing, 1,
                           ACTION_SPACES['seed5'], 0.1, 0.1)
    tensors = {name: torch.zeros(shape) for name, shape in own.shapes.items()}
    tensors['convolutions.0.weight'] += 1
    tensors['hidden.weight'] += torch.eye(256)
    tensors['output.weight'][:, :] = 0
    for action in range(5):
        tensors['output.weight'][action, 96 + 4 * action] = 255
    frame = np.repeat(np.arange(256, dtype=np.uint8)[None, None, None, :, None], 3, axis=4)
    values, _ = session_of(Model(own, tensors)).run(None, {'frames': frame})
    expected = Preprocessor(preprocessing)(frame[0, 0])[0, 96:116:4]
    assert np.array_equal(np.round(values[0], 4), expected)


def test_the_file_says_what_who_runs_it_has_to_know(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(['export', 'racing', '--onnx', 'lap.onnx']) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[1] == 'in   frames    uint8 (N, 4, 96, 96, 3), oldest first, 0.08 s apart'
    assert len(said) == 4 and max(map(len, said)) <= 80
    alone = (
        'import sys; sys.modules.update(torch=None, dqn_policy_node=None)\n'
        'import json, numpy, onnxruntime\n'
        'session = onnxruntime.InferenceSession("lap.onnx")\n'
        'told = session.get_modelmeta().custom_metadata_map\n'
        'frames = numpy.zeros((1, int(told["frame_stack"]), 96, 96, 3), numpy.uint8)\n'
        'told["shape"] = list(session.run(["command"], {"frames": frames})[0].shape)\n'
        'print(json.dumps(told))')
    done = subprocess.run([sys.executable, '-c', alone], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    own = load_model(find_model('racing')).description
    assert ModelDescription.from_json(json.loads(told['description'])) == own
    assert json.loads(told['actions']) == list(own.action_space.names)
    assert (told['name'], told['stack_seconds'], told['action_seconds'], told['shape']) == (
        'racing', '0.08', '0.04', [1, 2])


def test_a_run_folder_is_exported_by_its_best_model(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    save_model(tmp_path / 'run' / 'best', load_model(find_model('racetrack')))
    (tmp_path / 'run' / 'episodes.csv').write_text('episode\n')
    assert main(['export', 'run', '--onnx', 'it.onnx']) == 0
    found = onnxruntime.InferenceSession('it.onnx').get_modelmeta().custom_metadata_map
    assert found['name'] == 'run/best'


@pytest.mark.parametrize(('words', 'told'), [
    (['nowhere', '--onnx', 'x.onnx'], 'the shipped, which are mujoco_car, '),
    (['racing'], 'the following arguments are required: --onnx'),
    (['racing', '--onnx', 'no/x.onnx'], 'no/x.onnx cannot be written: No such file'),
    (['racing', '--onnx', 'there.onnx'], 'there.onnx exists already; nothing was overwritten'),
])
def test_bad_input_is_one_line(words, told, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'there.onnx').write_text('mine')
    assert main(['export', *words]) == 2
    error = capsys.readouterr().err
    assert told in error and len(error.splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ['there.onnx']
    assert (tmp_path / 'there.onnx').read_text() == 'mine'


def test_without_onnx_the_command_says_how_it_is_installed(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr('importlib.util.find_spec', lambda name: None)
    assert main(['export', 'racing', '--onnx', 'x.onnx']) == 2
    assert "onnx is not installed: pip install '.[onnx]'" in capsys.readouterr().err
