# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The cards of the shipped models say what their records say."""
import json
from pathlib import Path
import shutil

from carracing_dqn.evaluation.model_card import CARD, main, model_card
from dqn_policy_node.shipped_models import shipped_models
import pytest

MODELS = Path(__file__).resolve().parents[1] / 'models'


@pytest.mark.parametrize('name', shipped_models())
def test_a_card_is_what_its_record_makes(name):
    assert (MODELS / name / CARD).read_text(encoding='utf-8') == model_card(MODELS / name), (
        f'run python -m carracing_dqn.evaluation.model_card models/{name}')


def test_a_card_names_the_worst_seed_and_what_random_actions_earn():
    card = model_card(MODELS / 'racing')
    assert '| **training seed 44** | 41 | 930.65 ± 5.86 |' in card
    assert 'The worst of them by test is seed 43: 926.98 ± 6.99, lowest 906.7.' in card
    assert '| uniform random actions |  | -53.34 ± 5.43 |' in card


def test_a_card_follows_the_record(tmp_path):
    folder = tmp_path / 'mine'
    shutil.copytree(MODELS / 'mujoco_car', folder)
    (folder / 'record' / 'evaluation.json').unlink()
    shutil.rmtree(folder / 'record' / 'seed_42')
    shutil.rmtree(folder / 'record' / 'seed_43')
    card = model_card(folder)
    assert '## Test' not in card
    assert 'One training run' in card and 'It learned in `mujoco_car`' in card


def test_halves_of_signs_in_a_record_do_no_harm(tmp_path):
    shutil.copytree(MODELS / 'mujoco_car', tmp_path / 'mine')
    path = tmp_path / 'mine/record/run.json'
    record = json.loads(path.read_text())
    record['started'] = '\ud800'
    path.write_text(json.dumps(record))
    assert main([str(tmp_path / 'mine')]) == 0
    assert '| begun | ? |' in (tmp_path / 'mine' / CARD).read_text(encoding='utf-8')


@pytest.mark.parametrize('record', ['{}', '{"sessions": [], "seeds": 5}', '[]'])
def test_a_record_that_is_not_whole_is_one_line(tmp_path, capsys, record):
    shutil.copytree(MODELS / 'mujoco_car', tmp_path / 'mine')
    before = (tmp_path / 'mine' / CARD).read_bytes()
    (tmp_path / 'mine/record/run.json').write_text(record)
    assert main([str(tmp_path / 'mine')]) == main([str(tmp_path / 'nowhere')]) == 2
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 2 and 'the record of its training is not whole' in said[0]
    assert (tmp_path / 'mine' / CARD).read_bytes() == before
