# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The site of the documentation is built without a warning, where its generator is installed."""
from pathlib import Path
import re
import subprocess
import sys

import pytest

pytest.importorskip('sphinx', reason="Sphinx is not installed: pip install '.[docs]'")
pytest.importorskip('myst_parser', reason="MyST is not installed: pip install '.[docs]'")
pytest.importorskip('furo', reason="Furo is not installed: pip install '.[docs]'")

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope='module')
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp('site')
    done = subprocess.run(
        [sys.executable, '-m', 'sphinx', '-W', '--keep-going', '-q', '-c', 'docs', '.', folder],
        cwd=ROOT, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, '')
    return folder


def test_the_navigation_has_the_four_kinds(site):
    page = (site / 'docs' / 'tutorial.html').read_text(encoding='utf-8')
    assert re.findall(r'<span class="caption-text">(.+?)</span>', page) == [
        'Tutorial', 'How-to', 'Reference', 'Explanation']


def test_every_page_is_there_and_what_it_shows(site):
    for page in (*(ROOT / 'docs').rglob('*.md'), *(ROOT / 'models').glob('*/README.md')):
        assert (site / page.relative_to(ROOT).with_suffix('.html')).is_file()
    assert 'docs/index.html' in (site / 'index.html').read_text(encoding='utf-8')
    assert list((site / '_images').glob('lap*.webp'))


def test_the_api_is_made_from_docstrings(site):
    page = (site / 'docs' / 'api.html').read_text(encoding='utf-8')
    assert 'id="dqn_policy_node.policy.load_policy"' in page
    assert 'The folder cannot be used' in page or 'the folder cannot be used' in page
