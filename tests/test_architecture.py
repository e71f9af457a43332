# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The imports are those that docs/architecture.md allows."""
import ast
from fnmatch import fnmatch
from graphlib import TopologicalSorter
from pathlib import Path
import re

from setuptools import find_packages

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / 'docs' / 'architecture.md').read_text(encoding='utf-8')
SECTION = PAGE.split('## Who may know whom')[1].split('\n## ')[0]
ROWS = dict(re.findall(r'^\| `([\w.]+)` \|[^|]*\|([^|]*)\|$', SECTION, re.MULTILINE))
OURS = {name.split('.')[0] for name in ROWS}


def modules():
    """Return module name -> path of everything that is installed."""
    found = {}
    for top in sorted(OURS):
        for path in sorted((ROOT / top).rglob('*.py')):
            parts = path.relative_to(ROOT).with_suffix('').parts
            found['.'.join(parts[:-1] if parts[-1] == '__init__' else parts)] = path
    return found


MODULES = modules()


def imported(path, *, at_start=False):
    """Yield the modules a file imports, all of them or only those at its start."""
    tree = ast.parse(path.read_text(encoding='utf-8'))
    for node in tree.body if at_start else ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f'{path}: relative import'
            for alias in node.names:
                full = f'{node.module}.{alias.name}'
                yield full if full in MODULES else node.module


def package_of(module):
    """Return the row of the table that a module belongs to, '' for none."""
    return max((row for row in ROWS if f'{module}.'.startswith(f'{row}.')), key=len, default='')


def allowed(package):
    text = ROWS[package]
    named = set(re.findall(r'`([\w.]+)`', text))
    return set(ROWS) - named if text.strip().startswith('all but') else named


def test_every_import_is_one_that_the_table_allows():
    wrong = []
    for module, path in MODULES.items():
        own = package_of(module)
        for other in imported(path):
            there = package_of(other)
            if own and there and there != own and there not in allowed(own):
                wrong.append(f'{module} imports {other}')
    assert not wrong, '\n'.join(wrong)


def test_the_table_names_every_package():
    packages = {name for name in find_packages(str(ROOT)) if name.split('.')[0] in OURS}
    assert packages - {'carracing_dqn'} == set(ROWS)


def test_no_module_imports_in_a_circle():
    graph = {module: {other for other in imported(path, at_start=True) if other in MODULES}
             for module, path in MODULES.items()}
    assert len(list(TopologicalSorter(graph).static_order())) >= len(MODULES)


def test_only_nodes_and_what_the_page_names_import_rclpy():
    named = {path for path in re.findall(r'`(\w+/[\w/]+\.py)`', SECTION)}
    for path in MODULES.values():
        here = str(path.relative_to(ROOT))
        if any(name.split('.')[0] == 'rclpy' for name in imported(path)):
            assert here.endswith(('/node.py', '_node.py')) or here in named, here
    assert all((ROOT / path).is_file() for path in named)


GRAPH_CALLS = ('get_*names_and_types*', 'get_*info_by_topic', 'get_node_names*')


def test_what_rclpy_cannot_tell_of_the_graph_ends_nobody():
    """One name on the wire that is no text makes these calls raise, in whatever node."""
    bare = []
    for module, path in MODULES.items():
        tree = ast.parse(path.read_text(encoding='utf-8'))
        guarded = {id(inside) for node in ast.walk(tree) if isinstance(node, ast.Try)
                   for statement in node.body for inside in ast.walk(statement)}
        bare += [f'{module}, line {node.lineno}' for node in ast.walk(tree)
                 if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)
                 and any(fnmatch(node.func.attr, one) for one in GRAPH_CALLS)
                 and id(node) not in guarded and module != 'msgs_bridge.matching']
    assert not bare, '; '.join(bare)
