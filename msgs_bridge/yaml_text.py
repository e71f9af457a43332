# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""YAML as it comes from outside: bounded, safe, without aliases in either direction."""
from __future__ import annotations

from typing import Any

import yaml

from msgs_bridge.errors import BridgeError
from msgs_bridge.plain_text import plain

# A bag of a thousand topics needs a tenth of this.
MAX_TEXT = 4 << 20
MAX_BITS = 256


class _Loader(yaml.SafeLoader):
    """
    Refuses aliases and keys that come twice.

    A few lines of aliases unfold to gigabytes; of a key that comes twice one value would be lost
    without a word.
    """

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError('aliases are not accepted')
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        seen = set()
        for key, _ in node.value:
            name = (key.tag, key.value) if isinstance(key, yaml.ScalarNode) else id(key)
            if name in seen:
                raise yaml.YAMLError(f'{plain(key.value)!r} comes twice')
            seen.add(name)
        return super().construct_mapping(node, deep)

    def construct_yaml_int(self, node: Any) -> int:
        value = super().construct_yaml_int(node)
        if value.bit_length() > MAX_BITS:
            # Python refuses to write some thousands of digits
            raise yaml.YAMLError('a whole number of so many digits is not accepted')
        return value


_Loader.add_constructor('tag:yaml.org,2002:int', _Loader.construct_yaml_int)


class _Dumper(yaml.SafeDumper):
    def ignore_aliases(self, data: Any) -> bool:
        return True


def load_yaml(text: str, what: str, error: type[BridgeError]) -> Any:
    """
    Return the value of a YAML text; `what` names it in errors.

    Raises:
        error: longer than 4 MiB, not YAML, nested too deep, with aliases, with a key that comes
            twice in a mapping, or with a whole number of hundreds of digits.
    """
    if len(text) > MAX_TEXT:
        raise error(f'{what} has {len(text)} characters; accepted: {MAX_TEXT}')
    try:
        return yaml.load(text, _Loader)
    except Exception as problem:
        # what makes a value of a tag that the text names, like !!float, raises as it likes
        raise error(f'{what} is not valid YAML: {" ".join(str(problem).split())}') from None


def dump_yaml(value: Any) -> str:
    """Return a value as YAML text, keys in their order."""
    return yaml.dump(value, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=1000)
