# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Where policies come from: a model folder, the dummy agent, or anybody's own code."""
from __future__ import annotations

import contextlib
import dataclasses
import importlib
import inspect
import os
from pathlib import Path
import sys
from typing import Any

from carracing_dqn.evaluation.errors import PolicyError
from carracing_dqn.evaluation.laps import checked_command
from carracing_dqn.evaluation.sources import module_source
from dqn_policy_node.shipped_models import RANDOM
from msgs_bridge import blame
from msgs_bridge.plain_text import plain
from msgs_bridge.simulator import FRAME_SECONDS
from msgs_bridge.twists import Command

MODEL = 'model'
# the folders of a run folder that hold a model, the one to evaluate first
RUN_MODELS = ('best', 'final')


def _blamed(name: str, what: str) -> contextlib.AbstractContextManager[None]:
    """Let somebody's policy do something; what fails in it is a PolicyError."""
    return blame.blamed(f'policy {plain(name)!r}', what, PolicyError)


class Custom:
    """A policy of somebody else's: `act` is all it needs."""

    def __init__(self, made: Any, name: str) -> None:
        """Take an object with `act(frame)`, or a function of the frame, and its name."""
        self._made, self._name = made, name
        with _blamed(name, 'act'):
            self._act = made.act if hasattr(made, 'act') else made
        with _blamed(name, 'action_repeat'):
            self.action_repeat = max(1, int(getattr(made, 'action_repeat', 1)))

    def reset(self, seed: int | None = None) -> None:
        """Pass the reset on, with the seed if the policy takes one."""
        with _blamed(self._name, 'reset'):
            reset = getattr(self._made, 'reset', None)
            if reset is None:
                return
            if inspect.signature(reset).parameters:
                reset(seed)
            else:
                reset()

    def act(self, frame: Any) -> Command:
        """Return the command that the policy answers to a frame."""
        with _blamed(self._name, 'act'):
            # an answer may fail when it is looked at, too
            return checked_command(self._act(frame))


@dataclasses.dataclass(frozen=True)
class PolicySource:
    """
    How to open a policy; can be sent to other processes.

    Attributes:
        kind: 'model', 'random', or `module:callable`.
        model: model folder, when the kind is 'model'.
        device: where a model computes, as PyTorch names it.
        action_repeat: simulator frames a model's action is held; 0 = as the model says.
        weights_sha256: of the weights that a model must have; '' for whatever lies there.
    """

    kind: str
    model: str = ''
    device: str = 'cpu'
    action_repeat: int = 0
    weights_sha256: str = ''

    @property
    def name(self) -> str:
        """Return a short name for tables and figures."""
        if self.kind != MODEL:
            return self.kind
        folder = Path(self.model).resolve()
        if folder.name in RUN_MODELS:
            return f'{folder.parent.name}/{folder.name}'
        return folder.name

    @property
    def run_folder(self) -> Path | None:
        """Return the run folder that the model is of, None when it is of none."""
        folder = Path(self.model)
        is_run = folder.name in RUN_MODELS and (folder.parent / 'episodes.csv').is_file()
        return folder.parent if self.kind == MODEL and is_run else None

    def open(self, frame_seconds: float = FRAME_SECONDS) -> Any:
        """
        Return the policy.

        Args:
            frame_seconds: simulated seconds of a frame of what it is to drive.

        Raises:
            ModelError: the model folder cannot be used.
            PolicyError: there is no such callable, or what it makes cannot `act`; or the model
                was replaced by another one.
        """
        if self.kind == MODEL:
            from dqn_policy_node import load_policy
            policy = load_policy(self.model, self.device, frame_seconds=frame_seconds)
            self.check()
            if self.action_repeat:
                policy.action_repeat = self.action_repeat
            return policy
        if self.kind == RANDOM:
            return _random_policy()
        return Custom(_made_by(self.kind), self.kind)

    def check(self) -> None:
        """
        See that the model is still the one that was asked for: a run writes its best anew.

        Raises:
            ModelError: the model folder cannot be used.
            PolicyError: it is another one by now.
        """
        if self.weights_sha256:
            from dqn_policy_node.model_record import read_model_record
            if read_model_record(self.model).weights_sha256 != self.weights_sha256:
                raise PolicyError(f'{self.model} was replaced by another version meanwhile; begin '
                                  'again, or copy the folder and evaluate that')

    def identity(self) -> dict[str, Any]:
        """
        Return what makes its laps what they are, as JSON values.

        Raises:
            ModelError, PolicyError: as `open`.
        """
        if self.kind == MODEL:
            from dqn_policy_node.model_folder import load_model
            from dqn_policy_node.model_record import read_model_record
            load_model(self.model)
            # all of one reading: the folder may be replaced at any time
            model = read_model_record(self.model)
            description = model.description
            return {
                'kind': MODEL,
                'name': self.name,
                'weights_sha256': model.weights_sha256,
                'description_sha256': description.sha256(),
                'action_set': description.action_space.name,
                'action_repeat': self.action_repeat or round(
                    description.action_seconds / FRAME_SECONDS),
                'version': model.version,
            }
        if self.kind == RANDOM:
            from dqn_policy_node.action_space import DUMMY_SPACE
            return {'kind': RANDOM, 'name': RANDOM, 'action_set': DUMMY_SPACE.name,
                    'action_repeat': 1}
        self.open()
        return {'kind': 'custom', 'name': self.kind,
                'source_sha256': module_source(self.kind.partition(':')[0])}


def model_source(model: str, device: str = 'cpu') -> PolicySource:
    """
    Return the source of a model folder, of a run folder's best model, or of a shipped model.

    Raises:
        ModelError: there is none of the three.
    """
    from dqn_policy_node import find_model
    folder = Path(os.path.expanduser(model))
    if (folder / 'episodes.csv').is_file() and not (folder / 'model.json').is_file():
        for name in RUN_MODELS:
            if (folder / name / 'model.json').is_file():
                return PolicySource(MODEL, str(folder / name), device)
        raise PolicyError(
            f'{folder} is a run without a model yet: neither {" nor ".join(RUN_MODELS)} is there')
    path = str(find_model(model))
    # a folder that is called random is no dummy agent
    return PolicySource(MODEL, os.path.join('.', path) if path == RANDOM else path, device)


def parse_policy(text: str, model: str, device: str = 'cpu') -> PolicySource:
    """
    Return the source that `--policy` and `--model` ask for.

    Raises:
        PolicyError: the text is neither 'model' nor 'random' nor `module:callable`.
        ModelError: there is no such model.
    """
    if text == MODEL:
        return model_source(model, device)
    if text == RANDOM:
        return PolicySource(RANDOM)
    module, colon, name = text.partition(':')
    if not (colon and module and name):
        raise PolicyError(f"policy is {text!r}; accepted: 'model', 'random', or module:callable")
    return PolicySource(text)


def _random_policy() -> Any:
    from dqn_policy_node import RandomPolicy
    from dqn_policy_node.action_space import DUMMY_SPACE
    policy = RandomPolicy(DUMMY_SPACE)
    policy.looks_at_frames = False
    return policy


def _made_by(text: str) -> Any:
    """Return what `module:callable` makes: a policy object, or the function of a frame itself."""
    module_name, _, name = text.partition(':')
    if os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())
    try:
        with _blamed(text, 'its import'):
            value: Any = importlib.import_module(module_name)
    except PolicyError as error:
        raise PolicyError(f'cannot import {module_name!r}: {error}') from None
    for part in name.split('.'):
        with _blamed(text, 'its import'):
            # a module may import what it offers only now
            found = hasattr(value, part)
        if not found:
            raise PolicyError(f'policy {text!r}: {module_name} has no {name!r}')
        value = getattr(value, part)
    if hasattr(value, 'act') and not isinstance(value, type):
        return value
    if not callable(value):
        raise PolicyError(f'policy {text!r} is a {type(value).__name__}, which cannot be called')
    try:
        inspect.signature(value).bind()
    except (TypeError, ValueError):
        # takes an argument: a function of the frame
        return value
    with _blamed(text, 'its making'):
        made = value()
    if not callable(getattr(made, 'act', made)):
        raise PolicyError(
            f'policy {text!r} made a {type(made).__name__}; expected an object with act(frame)')
    return made
