# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Model folders and weights images on real bytes, damaged ones included."""
import errno
import json
import os

from dqn_policy_node import model_folder
from dqn_policy_node.action_space import ACTION_SPACES
from dqn_policy_node.errors import ModelError
from dqn_policy_node.model_description import (
    ModelDescription, Network, parse_convolutions, Preprocessing,
)
from dqn_policy_node.model_folder import load_model, Model, save_model
from dqn_policy_node.network import QNetwork
from dqn_policy_node.safetensors_image import pack
from dqn_policy_node.shipped_models import find_model
from dqn_policy_node.weights_message import (
    decode_weights, encode_weights, is_marked, NewestWeights, WeightsUpdate,
)
from msgs_bridge import atomic_write
from msgs_bridge.share import share_path
import pytest
import torch


def make_description(**changes):
    values = {
        'network': Network(parse_convolutions('4@4/4 4@3/2'), 8, True),
        'preprocessing': Preprocessing(shrink=4), 'frame_stack': 2,
        'action_space': ACTION_SPACES['seed5'], 'action_seconds': 0.08,
        'stack_seconds': 0.08}
    return ModelDescription(**{**values, **changes})


@pytest.fixture
def description():
    return make_description()


@pytest.fixture
def tensors(description):
    torch.manual_seed(0)
    return QNetwork(description).state_dict()


@pytest.fixture
def folder(tmp_path, description, tensors):
    save_model(tmp_path / 'model', Model(description, tensors, {'note': 'x'}, 7))
    return tmp_path / 'model'


def test_the_network_has_exactly_the_described_tensors(description, tensors):
    assert {name: tuple(t.shape) for name, t in tensors.items()} == description.shapes
    plain = make_description(network=Network(parse_convolutions('4@4/4'), 8))
    assert {name: tuple(t.shape) for name, t in QNetwork(plain).state_dict().items()} == (
        plain.shapes)
    assert sum(t.numel() for t in tensors.values()) == description.parameters


def test_a_model_folder_gives_back_what_went_in(folder, description, tensors):
    model = load_model(folder)
    assert model.description == description
    assert (model.training, model.version) == ({'note': 'x'}, 7)
    assert all(torch.equal(model.tensors[name], tensors[name]) for name in tensors)
    assert sorted(os.listdir(folder)) == ['model.json', 'weights.safetensors']
    assert sorted(os.listdir(folder.parent)) == ['model']


def test_a_model_folder_is_replaced_whole(folder, description, tensors):
    save_model(folder, Model(description, tensors, {}, 8))
    assert load_model(folder).version == 8
    assert sorted(os.listdir(folder.parent)) == ['model']


def test_a_full_disk_keeps_the_old_model(folder, description, tensors, monkeypatch):
    def full(path, data):
        raise OSError(errno.ENOSPC, 'No space left on device')
    monkeypatch.setattr(model_folder, 'write_bytes', full)
    with pytest.raises(OSError, match='No space'):
        save_model(folder, Model(description, tensors, {}, 9))
    assert load_model(folder).version == 7
    assert sorted(os.listdir(folder.parent)) == ['model']


def test_a_failing_swap_puts_the_old_model_back(folder, description, tensors, monkeypatch):
    rename = type(folder).rename

    def fail_on_new(self, target):
        if self.name == 'new':
            raise OSError(errno.EIO, 'Input/output error')
        return rename(self, target)
    monkeypatch.setattr(type(folder), 'rename', fail_on_new)
    # as on a file system that cannot exchange two folders in one step
    monkeypatch.setattr(atomic_write, '_exchange', lambda first, second: False)
    with pytest.raises(OSError, match='Input/output'):
        save_model(folder, Model(description, tensors, {}, 9))
    monkeypatch.undo()
    assert load_model(folder).version == 7


def test_nothing_but_a_model_is_ever_replaced(tmp_path, description, tensors):
    (tmp_path / 'letters').mkdir()
    (tmp_path / 'letters' / 'a.txt').write_text('dear')
    with pytest.raises(ModelError, match='is no model folder'):
        save_model(tmp_path / 'letters', Model(description, tensors))
    assert (tmp_path / 'letters' / 'a.txt').read_text() == 'dear'


def flip_last_byte(path):
    data = bytearray(path.read_bytes())
    data[-1] ^= 1
    path.write_bytes(data)


@pytest.mark.parametrize(('damage', 'text'), [
    (lambda f: (f / 'model.json').unlink(), 'model.json: no such file'),
    (lambda f: (f / 'weights.safetensors').unlink(), 'weights.safetensors: no such file'),
    (lambda f: flip_last_byte(f / 'weights.safetensors'), 'damaged, its hash'),
    (lambda f: (f / 'weights.safetensors').write_bytes(b''), 'damaged, its hash'),
    (lambda f: (f / 'model.json').write_text('{'), 'model.json: JSONDecodeError'),
    (lambda f: (f / 'model.json').write_text('[]'), 'format is not'),
    (lambda f: (f / 'model.json').write_bytes(b'{\xff'), 'model.json: UnicodeDecodeError'),
    (lambda f: (f / 'model.json').write_text('[' * 100000), 'model.json: RecursionError'),
])
def test_a_damaged_folder_names_the_file_in_one_line(folder, damage, text):
    damage(folder)
    with pytest.raises(ModelError, match=text) as caught:
        load_model(folder)
    assert '\n' not in str(caught.value)
    assert str(folder) in str(caught.value)


@pytest.mark.parametrize('change', [
    lambda record: record['description'].update(action_seconds=0.04),
    lambda record: record.update(version=8),
    lambda record: record['training'].update(decisions=10**9),
    lambda record: record.update(format='carracing_dqn model 1'),
    lambda record: record.pop('record_sha256'),
])
def test_a_record_changed_by_hand_does_not_match_its_hash(folder, change):
    record = json.loads((folder / 'model.json').read_text())
    change(record)
    (folder / 'model.json').write_text(json.dumps(record))
    with pytest.raises(ModelError, match='model.json: damaged, it does not match its hash'):
        load_model(folder)


def test_a_version_that_no_message_can_say_is_named(folder, description, tensors):
    save_model(folder, Model(description, tensors, {}, 10**400))
    with pytest.raises(ModelError, match='model.json: version has more than 16 digits'):
        load_model(folder)


@pytest.mark.parametrize('name', ['model.json', 'weights.safetensors'])
@pytest.mark.parametrize('make', [os.mkfifo, lambda path: path.symlink_to('/dev/zero')])
def test_what_never_ends_is_not_read(folder, name, make):
    (folder / name).unlink()
    make(folder / name)
    with pytest.raises(ModelError, match=f'{name}: not a regular file'):
        load_model(folder)


def test_a_missing_folder_is_one_line(tmp_path):
    with pytest.raises(ModelError, match='no such file'):
        load_model(tmp_path / 'nothing')
    with pytest.raises(ModelError, match="no model 'nothing-like-it'"):
        find_model('nothing-like-it')
    with pytest.raises(FileNotFoundError, match='is in none of'):
        share_path('config/none.yaml')
    assert share_path('config/report.yaml').is_file()


def test_find_model_takes_a_path(folder):
    assert find_model(folder) == folder


def test_a_weights_image_gives_back_what_went_in(description, tensors):
    data = encode_weights(tensors, description, version=3, epsilon=0.25, gas_weight=4.0,
                          exploration_hold=7, validate=True, extra={'updates': 5})
    update = decode_weights(data, description)
    assert (update.version, update.epsilon, update.gas_weight, update.exploration_hold) == (
        3, 0.25, 4.0, 7)
    assert update.validate is True and is_marked(data)
    assert not is_marked(encode_weights(tensors, description, version=3))
    assert update.extra == {'updates': 5}
    assert all(torch.equal(update.tensors[name], tensors[name]) for name in tensors)
    assert decode_weights(data).description == description
    assert decode_weights(data).description == description


def test_every_flipped_byte_and_every_cut_is_noticed(description, tensors):
    data = encode_weights(tensors, description, version=3)
    intact = decode_weights(data, description)
    for place in range(0, len(data), 97):
        damaged = bytearray(data)
        damaged[place] ^= 0x10
        try:
            update = decode_weights(bytes(damaged), description)
        except ModelError:
            continue
        # only what is not hashed, like white space in the header, may go unnoticed
        assert all(torch.equal(update.tensors[n], intact.tensors[n]) for n in intact.tensors)
    for length in (0, 7, 8, 100, len(data) - 1):
        with pytest.raises(ModelError):
            decode_weights(data[:length], description)


def test_weights_for_another_model_say_what_differs(description, tensors):
    data = encode_weights(tensors, description, version=1)
    with pytest.raises(ModelError, match='another model: action_seconds is 0.08, not 0.04'):
        decode_weights(data, make_description(action_seconds=0.04))


@pytest.mark.parametrize(('values', 'text'), [
    ({'epsilon': 1.5}, 'epsilon 1.5'), ({'epsilon': float('nan')}, 'epsilon nan'),
    ({'version': -1}, 'version -1'), ({'version': 1.5}, 'version 1.5'),
    ({'gas_weight': 0.0}, 'gas_weight 0.0'), ({'exploration_hold': 0}, 'exploration_hold 0'),
    ({'validate': 2}, 'wrong type'),
])
def test_impossible_values_are_refused(description, tensors, values, text):
    data = encode_weights(tensors, description, **{'version': 1, **values})
    with pytest.raises(ModelError, match=text):
        decode_weights(data, description)


@pytest.mark.parametrize(('change', 'text'), [
    (lambda t: t.pop('value.bias'), "lacks tensor 'value.bias'"),
    (lambda t: t.update(evil=torch.zeros(1)), "unknown tensor 'evil'"),
    (lambda t: t.update({'value.bias': torch.zeros(2)}), "'value.bias' are torch.float32"),
    (lambda t: t['value.bias'].fill_(float('nan')), 'not all finite'),
])
def test_foreign_tensors_are_refused(description, tensors, change, text):
    tensors = dict(tensors)
    change(tensors)
    with pytest.raises(ModelError, match=text):
        decode_weights(encode_weights(tensors, description, version=1), description)


def test_what_is_no_weights_image_at_all_is_refused(description, tensors):
    with pytest.raises(ModelError, match='is not a .carracing_dqn weights 2'):
        decode_weights(pack(tensors, {}), description)
    with pytest.raises(ModelError, match='header of'):
        decode_weights(b'\xff' * 100)
    with pytest.raises(ModelError, match='not JSON'):
        decode_weights((8).to_bytes(8, 'little') + b'{{{{{{{{')


def test_weights_older_than_those_at_work_are_refused_unless_a_trainer_has_begun_anew():
    newest = NewestWeights()

    def check(version, session='a'):
        newest.check(WeightsUpdate({}, None, version, session=session))

    for version in (3, 3, 7):
        check(version)
    with pytest.raises(ModelError, match='version 6 is older than 7'):
        check(6)
    # a trainer that was started again resumes from an earlier version
    check(4, 'b')
    with pytest.raises(ModelError, match='earlier start'):
        check(8)
    with pytest.raises(ModelError, match='older'):
        check(3, 'b')
    check(5, 'b')
