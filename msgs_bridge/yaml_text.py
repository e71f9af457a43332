# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""YAML as it comes from outside: bounded, safe, without aliases in either direction."""
from __future__ import annotations

from typing import Any

import yaml

from msgs_bridge.errors import BridgeError

# A bag of a thousand topics needs a tenth of this.
MAX_TEXT = 4 << 20


class _Loader(yaml.SafeLoader):
    """Refuses aliases: a few lines of them unfold to gigabytes."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError('aliases are not accepted')
        return super().compose_node(parent, index)


class _Dumper(yaml.SafeDumper):
    def ignore_aliases(self, data: Any) -> bool:
        return True


def load_yaml(text: str, what: str, error: type[BridgeError]) -> Any:
    """
    Return the value of a YAML text; `what` names it in errors.

    Raises:
        error: longer than 4 MiB, not YAML, nested too deep, or with aliases.
    """
    if len(text) > MAX_TEXT:
        raise error(f'{what} has {len(text)} characters; accepted: {MAX_TEXT}')
    try:
        return yaml.load(text, _Loader)
    except (yaml.YAMLError, RecursionError, ValueError) as problem:
        raise error(f'{what} is not valid YAML: {" ".join(str(problem).split())}') from None


def dump_yaml(value: Any) -> str:
    """Return a value as YAML text, keys in their order."""
    return yaml.dump(value, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=1000)
