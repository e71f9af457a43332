# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""README and the pages say what the code says, and lead where they say."""
import json
from pathlib import Path
import re

from carracing_dqn.bringup.command import SUBCOMMANDS
from carracing_dqn.bringup.environment import executables
from carracing_dqn.bringup.graph import KINDS
from carracing_dqn.bringup.reference_tables import SETTINGS, with_tables
import pytest

ROOT = Path(__file__).resolve().parents[1]
README = ROOT / 'README.md'
DOCS = sorted((ROOT / 'docs').rglob('*.md'))
PAGES = [README, ROOT / 'CONTRIBUTING.md', ROOT / 'CHANGELOG.md', *DOCS,
         *sorted((ROOT / 'models').glob('*/README.md'))]
REFERENCE = (ROOT / 'docs' / 'reference.md').read_text(encoding='utf-8')


def links(page):
    """Return (path, anchor) of every link of a page that stays in the checkout, code left out."""
    text = re.sub(r'^```.*?^```$|`[^`\n]*`', '', page.read_text(encoding='utf-8'),
                  flags=re.MULTILINE | re.DOTALL)
    return [(page if path == '' else page.parent / path, anchor)
            for path, anchor in re.findall(r'\]\(([^)#:\s]*)#?([^)\s:]*)\)', text)]


def anchors(page):
    """Return what a page's headings can be linked by, as GitHub and the site make it."""
    text = re.sub(r'^```.*?^```$', '', page.read_text(encoding='utf-8'),
                  flags=re.MULTILINE | re.DOTALL)
    return {re.sub(r'[^\w\- ]', '', heading.lower()).replace(' ', '-')
            for heading in re.findall(r'^#+ (.+)$', text, re.MULTILINE)}


@pytest.mark.parametrize('page', PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_the_tables_are_those_of_the_code(page):
    text = page.read_text(encoding='utf-8')
    assert with_tables(text) == text, (
        f'run python -m carracing_dqn.bringup.reference_tables {page.relative_to(ROOT)}')


def test_every_table_is_on_a_page_and_those_of_the_nodes_are_in_the_reference():
    pages = ''.join(page.read_text(encoding='utf-8') for page in PAGES)
    for name in SETTINGS:
        assert f'<!-- table: {name} -->' in pages
    for name in ('commands', 'topics', *(kind.name for kind in KINDS)):
        assert f'<!-- table: {name} -->' in REFERENCE


def test_every_command_and_node_is_named():
    for name in (*SUBCOMMANDS, *executables()):
        assert name in REFERENCE, name


def test_the_readme_is_a_first_page():
    assert len(README.read_text(encoding='utf-8').splitlines()) <= 120
    assert '<!-- table' not in README.read_text(encoding='utf-8')
    assert (ROOT / 'docs' / 'images' / 'lap.webp').stat().st_size <= 700_000


@pytest.mark.parametrize('model', ['racing', 'report'])
@pytest.mark.parametrize('page', ['README.md', 'docs/learning.md', 'docs/seed_document.md'])
def test_what_a_shipped_model_earned_is_that_of_its_record(page, model):
    record = json.loads((ROOT / 'models' / model / 'record' / 'evaluation.json').read_text())
    mean, std = (record['statistics'][name] for name in ('mean', 'std'))
    said = re.findall(r'\b\d{3}(?:\.\d+)? ± \d+(?:\.\d+)?', (ROOT / page).read_text('utf-8'))
    assert any(f'{mean:.{digits}f} ± {std:.{digits}f}' in said for digits in range(3))


def test_the_index_lists_every_page_under_one_kind():
    index = ROOT / 'docs' / 'index.md'
    listed = [path.resolve() for path, _ in links(index)]
    for page in PAGES:
        if page != index:
            assert listed.count(page) == 1, page.relative_to(ROOT)
    assert re.findall(r'^## (.+)$', index.read_text(encoding='utf-8'), re.MULTILINE) == [
        'Tutorial', 'How-to', 'Reference', 'Explanation']


@pytest.mark.parametrize('page', PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_leads_somewhere(page):
    for path, anchor in links(page):
        assert path.exists(), f'{page.name}: {path}'
        if anchor:
            assert anchor in anchors(path), f'{page.name}: {path.name}#{anchor}'


def test_no_picture_lies_around_unused():
    shown = ''.join(page.read_text(encoding='utf-8') for page in PAGES)
    for picture in (ROOT / 'docs' / 'images').iterdir():
        assert picture.name in shown, picture.name
