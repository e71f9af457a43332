# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The checkpoint of a run: the state of each of its parts, written whole or not at all."""
from __future__ import annotations

from collections.abc import Mapping
import dataclasses
from pathlib import Path
from typing import Any, Protocol, TYPE_CHECKING

import numpy as np

from msgs_bridge.errors import BridgeError
from msgs_bridge.settings import from_mapping
from trainer_node.checkpoint_file import read_checkpoint, write_checkpoint
from trainer_node.errors import RunError
from trainer_node.hyperparameters import Hyperparameters
from trainer_node.observation_blocks import ObservationBlocks
from trainer_node.saved_state import from_json
from trainer_node.shaping import REWARD_SETTINGS

if TYPE_CHECKING:
    from trainer_node.replay_buffer import ReplayBuffer

# what the contents of a checkpoint are made for or made with, beside the model
FIXED_SETTINGS = (
    'seed', 'learner', 'replay_capacity', 'tuner_series', 'initial_model', 'demonstrations',
    *REWARD_SETTINGS)


class Part(Protocol):
    """
    A part of a run that goes on where it was.

    Attributes:
        State: the dataclass that `state` returns, with fields as `saved_state` reads them.
    """

    State: type

    def state(self) -> Any:
        """Return what it is, apart from arrays."""

    def arrays(self) -> dict[str, np.ndarray]:
        """Return its arrays by name."""

    def restore(self, state: Any, arrays: dict[str, np.ndarray]) -> None:
        """Go on from there; any error of Python's says that it does not fit."""


@dataclasses.dataclass(frozen=True)
class SavedRun:
    """
    What a checkpoint file holds.

    Attributes:
        settings: the hyperparameters that it was made with.
        arrays, state: of all parts.
    """

    settings: Hyperparameters
    arrays: dict[str, np.ndarray]
    state: dict[str, Any]


class Checkpoint:
    """Writes and reads the checkpoint of one run folder."""

    def __init__(self, path: Path) -> None:
        """Name the file; blocks of observations lie beside it."""
        self.path = path
        self._blocks = ObservationBlocks(path.parent)

    def save(
        self, settings: Hyperparameters, parts: Mapping[str, Part], replay: ReplayBuffer,
    ) -> Path:
        """
        Write everything; return the path.

        Raises:
            RunError: the disk is full or the folder cannot be written; the checkpoint before
                stays whole.
        """
        try:
            arrays = {f'{name}.{key}': array for name, part in parts.items()
                      for key, array in part.arrays().items()}
            arrays['observations'] = self._blocks.write(replay)
            state = {name: dataclasses.asdict(part.state()) for name, part in parts.items()}
            write_checkpoint(self.path, arrays, {
                'settings': dataclasses.asdict(settings),
                'blocks': {str(block): sum_ for block, sum_ in self._blocks.checksums.items()},
                **state})
            self._blocks.remove_unneeded(replay)
        except OSError as error:
            raise RunError(f'{self.path} cannot be written: {error.strerror}') from None
        return self.path

    def read(self) -> SavedRun:
        """
        Read the file; nothing but its settings is looked at yet.

        Raises:
            RunError: it is missing or damaged, or its settings are not accepted.
        """
        arrays, state = read_checkpoint(self.path)
        try:
            settings = from_mapping(Hyperparameters, state['settings'])
        except (BridgeError, KeyError, TypeError, AttributeError) as error:
            raise RunError(f'{self.path}: damaged checkpoint: settings: {error}') from None
        return SavedRun(settings, arrays, state)

    def restore(
        self, saved: SavedRun, parts: Mapping[str, Part], replay: ReplayBuffer,
    ) -> None:
        """
        Let the parts of a run go on from what was read.

        Raises:
            RunError: it is damaged, or does not fit the parts.
        """
        try:
            for name, part in parts.items():
                arrays = {key.removeprefix(f'{name}.'): array for key, array in
                          saved.arrays.items() if key.startswith(f'{name}.')}
                part.restore(from_json(part.State, saved.state.get(name), name), arrays)
            self._blocks.read(replay, saved.arrays['observations'], {
                int(block): sum_ for block, sum_ in saved.state['blocks'].items()})
        except RunError as error:
            if str(self.path.parent) in str(error):
                raise
            raise RunError(f'{self.path}: damaged checkpoint: {error}') from None
        except (KeyError, ValueError, TypeError, AttributeError, RuntimeError, OverflowError,
                IndexError) as error:
            text = str(error).splitlines()[0][:200] if str(error) else type(error).__name__
            raise RunError(f'{self.path}: damaged checkpoint: {text}') from None
        self._blocks.remove_unneeded(replay)


def refuse_differences(
    settings: Hyperparameters, saved: Hyperparameters, run: Path,
) -> None:
    """
    See that a run can go on with other settings.

    Raises:
        RunError: its checkpoint is of another model or learner, or its rewards were made
            otherwise; the text says what differs.
    """
    differences = settings.model_description().differences(saved.model_description())
    for name in FIXED_SETTINGS:
        if getattr(settings, name) != getattr(saved, name):
            differences.append(f'{name} is {getattr(settings, name)}, not {getattr(saved, name)}')
    if bool(settings.weight_average) != bool(saved.weight_average):
        differences.append(
            f'weight_average is {settings.weight_average}, not {saved.weight_average}')
    if differences:
        raise RunError(
            f'{run} cannot be resumed with these settings, because its checkpoint '
            'differs: ' + '; '.join(differences))
