# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Settings: one description, checked everywhere alike."""
import dataclasses

from msgs_bridge.errors import SettingsError
from msgs_bridge.settings import from_mapping, markdown_table, parse_text, setting
import pytest


@dataclasses.dataclass(frozen=True)
class Example:
    """Settings of a made-up thing."""

    rate: float = setting(1.0, 'speed', low=0.0, high=10.0)
    count: int = setting(3, 'how many', low=1, high=5)
    mode: str = setting('a', 'which', choices=('a', 'b'))
    on: bool = setting(False, 'whether')


def test_defaults_and_values():
    assert from_mapping(Example, {}) == Example()
    assert from_mapping(Example, {'rate': 2, 'on': True}) == Example(rate=2.0, on=True)


@pytest.mark.parametrize('values, words', [
    ({'rte': 1.0}, "unknown setting 'rte'; did you mean 'rate'"),
    ({'rate': 11.0}, 'rate is 11.0; accepted: 0 to 10'),
    ({'rate': float('nan')}, 'finite'),
    ({'count': 2.5}, 'count must be a whole number'),
    ({'count': True}, 'count must be a whole number'),
    ({'mode': 'c'}, "accepted: one of 'a', 'b'"),
])
def test_what_is_not_accepted_is_named(values, words):
    with pytest.raises(SettingsError, match=words):
        from_mapping(Example, values)


def test_typed_values_are_read_by_their_type():
    assert parse_text(Example, 'count', '4') == 4
    assert parse_text(Example, 'on', 'true') is True
    with pytest.raises(SettingsError, match='count must be a whole number'):
        parse_text(Example, 'count', 'four')
    with pytest.raises(SettingsError, match='did you mean'):
        parse_text(Example, 'cuont', '4')


def test_the_table_has_a_row_for_every_setting():
    table = markdown_table(Example).splitlines()
    assert len(table) == 2 + 4
    assert table[2] == '| `rate` | float | `1.0` | 0 to 10 | speed |'
