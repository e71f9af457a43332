# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Policies: frames in, actions out, with their own stacking and action repeat."""
from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from dqn_policy_node.action_hold import ActionHold
from dqn_policy_node.action_space import ActionSpace
from dqn_policy_node.errors import ModelError
from dqn_policy_node.frame_stack import FrameStack
from dqn_policy_node.model_description import ModelDescription
from dqn_policy_node.model_folder import load_model
from dqn_policy_node.network import QNetwork
from dqn_policy_node.preprocessing import Preprocessor
from dqn_policy_node.shipped_models import find_model
from dqn_policy_node.weights_message import WeightsUpdate
from msgs_bridge.simulator import FRAME_SECONDS
from msgs_bridge.stamps import NANOSECONDS
from msgs_bridge.twists import Command

# of the lengths of explorations: three of five last one decision, one of six four or more
ZETA_EXPONENT = 2.0


class Answer(NamedTuple):
    """
    What a policy answers to a frame.

    Attributes:
        action: what was chosen, as the action space encodes it.
        command: what it means.
        q_values: float32 (outputs,), or None when nothing computed them.
        explored: whether it was drawn at random.
        decided: whether this frame was decided on; otherwise an action is held.
    """

    action: Any
    command: Command
    q_values: np.ndarray | None
    explored: bool
    decided: bool = True

    def held(self) -> Answer:
        """Return the answer to frames in which its action is held."""
        return self._replace(decided=False) if self.decided else self


class _Acting:
    """
    What all policies share: an action is decided on and then held.

    Attributes:
        action_space: what it chooses from.
        action_seconds: for how long an action is held; 0: every frame is decided on.
        frame_seconds: between the frames that `act` gets.
    """

    action_space: ActionSpace
    action_seconds: float
    frame_seconds = FRAME_SECONDS

    def __init__(self) -> None:
        self._hold = ActionHold()
        self._frames = 0
        self._command: Command | None = None

    @property
    def action_names(self) -> tuple[str, ...]:
        """Return the name of each action."""
        return self.action_space.names

    @property
    def action_repeat(self) -> int:
        """Return for how many frames of `act` an action is held, at least 1; can be set."""
        return max(1, round(self.action_seconds / self.frame_seconds))

    @action_repeat.setter
    def action_repeat(self, frames: int) -> None:
        self.action_seconds = frames * self.frame_seconds

    def act(self, frame: np.ndarray) -> Command:
        """
        Return the command for one frame of a simulator.

        Args:
            frame: uint8 (frame_height, frame_width, 3) rgb, one every `frame_seconds`. Those in
                which an action is held are not looked at.
        """
        now = round(self._frames * self.frame_seconds * NANOSECONDS)
        self._frames += 1
        if self._hold.is_due(now, round(self.action_seconds * NANOSECONDS)):
            self._command = self.decide(frame).command
        return self._command

    def decide(self, frame: np.ndarray, elapsed: int | None = None) -> Answer:
        """Return the decision on a frame, `elapsed` ns after the one before."""
        raise NotImplementedError

    def _begin(self) -> None:
        """Forget the action that is held."""
        self._hold.reset()
        self._frames = 0


class Policy(_Acting):
    """
    Acts epsilon-greedily by a Q-network.

    Attributes:
        description: what the model is.
        action_seconds: for how long an action is held; the model's own at first.
        epsilon: share of random actions, 0 = always the best.
        gas_weight: how much likelier than others a random action is one with gas.
        exploration_hold: most decisions for which a random action is held; how many is drawn
            from a zeta distribution of exponent 2 (arXiv 2006.01782).
        axes_share: of the episodes that are driven with the axes of the action space alone, the
            others with its single commands; None: every decision chooses from both.
        version: version of the weights.
    """

    def __init__(
        self, description: ModelDescription, *, device: str = 'cpu', seed: int | None = None,
        frame_seconds: float = FRAME_SECONDS,
    ) -> None:
        """
        Make a policy with random weights.

        Args:
            description: what the model is.
            device: where to compute, as PyTorch names it.
            seed: of its exploration.
            frame_seconds: simulated seconds of a frame of the simulator that `act` drives.
        """
        super().__init__()
        self.description = description
        self.action_space = description.action_space
        self.action_seconds = description.action_seconds
        self.frame_seconds = frame_seconds
        self.epsilon = 0.0
        self.gas_weight = 1.0
        self.exploration_hold = 1
        self.axes_share: float | None = None
        # what of the action space this episode is driven with, as its methods take it
        self._part: dict[str, Any] = {}
        self._explored: Any = None
        self._explorations_left = 0
        self.version = 0
        self._device = torch.device(device)
        self._network = QNetwork(description).to(self._device).eval()
        self._network.requires_grad_(False)
        self._preprocess = Preprocessor(description.preprocessing)
        self._stack = FrameStack(
            description.frame_stack, description.preprocessing.shape,
            round(description.stack_seconds * NANOSECONDS))
        self._random = np.random.default_rng(seed)

    def reset(self, seed: int | None = None) -> None:
        """Start an episode: forget frames and held action; a seed restarts the exploration."""
        self._begin()
        self._stack.reset()
        self._explorations_left = 0
        if seed is not None:
            self._random = np.random.default_rng(seed)
        self._part = {} if self.axes_share is None else {'modes': self.action_space.part(
            axes=bool(self._random.random() < self.axes_share))}

    def decide(self, frame: np.ndarray, elapsed: int | None = None) -> Answer:
        """
        Push a frame on the stack and choose an action.

        Args:
            frame: uint8 (frame_height, frame_width, 3) rgb.
            elapsed: ns since the last decision; None for `action_seconds`.

        Raises:
            MessageError: the frame has another shape or type.
        """
        if elapsed is None:
            elapsed = round(self.action_seconds * NANOSECONDS)
        q_values = self.q_values(self._stack.push(self._preprocess(frame), elapsed))
        explored = self._explores()
        action = self._explored if explored else self.action_space.greedy(
            q_values, **self._part)
        return Answer(action, self.action_space.decode(action), q_values, bool(explored))

    @torch.inference_mode()
    def q_values(self, observations: np.ndarray) -> np.ndarray:
        """Return the Q-values, float32 (actions,), of a stack, uint8 (stack, H, W)."""
        batch = torch.from_numpy(observations).unsqueeze(0).to(self._device)
        return self._network(self._network.prepare(batch))[0].cpu().numpy()

    def swap_weights(self, update: WeightsUpdate) -> None:
        """
        Act by other weights from the next decision on; frames and held action stay.

        Raises:
            ModelError: they are for another model.
        """
        if update.description != self.description:
            difference = update.description.differences(self.description)[0]
            raise ModelError(f'weights are for another model: {difference}')
        self._network.load_state_dict(update.tensors)
        self.version = update.version
        self.epsilon = update.epsilon
        self.gas_weight = update.gas_weight
        self.exploration_hold = update.exploration_hold
        self.axes_share = update.axes_share

    def act_greedily(self) -> None:
        """Explore nothing and choose from the whole action space, whatever came with weights."""
        self.epsilon, self.axes_share, self._part = 0.0, None, {}

    def _explores(self) -> bool:
        """Return whether to act at random now, by `_explored`."""
        if self._explorations_left == 0:
            if not (self.epsilon > 0 and self._random.random() < self.epsilon):
                return False
            self._explored = self.action_space.explore(
                self._random, self.gas_weight, **self._part)
            self._explorations_left = 1
            if self.exploration_hold > 1:
                self._explorations_left = int(min(
                    self._random.zipf(ZETA_EXPONENT), self.exploration_hold))
        self._explorations_left -= 1
        return True


class RandomPolicy(_Acting):
    """Draws every action uniformly: the report's dummy agent (3.2.3)."""

    def __init__(
        self, action_space: ActionSpace, *, action_seconds: float = 0.0,
        seed: int | None = None,
    ) -> None:
        """Draw from a space, a new action every `action_seconds`; 0: at every frame."""
        super().__init__()
        self.action_space = action_space
        self.action_seconds = action_seconds
        self.epsilon = 1.0
        self.version = 0
        self.description = None
        self._random = np.random.default_rng(seed)

    def reset(self, seed: int | None = None) -> None:
        """Start an episode; a seed restarts the draws."""
        self._begin()
        if seed is not None:
            self._random = np.random.default_rng(seed)

    def decide(self, frame: np.ndarray, elapsed: int | None = None) -> Answer:
        """Draw an action whatever the frame shows."""
        action = self.action_space.explore(self._random)
        return Answer(action, self.action_space.decode(action), None, True)


def load_policy(
    folder: Path | str, device: str = 'cpu', *, seed: int | None = None,
    frame_seconds: float = FRAME_SECONDS,
) -> Policy:
    """
    Return the greedy policy of a model.

    Args:
        folder: folder with `model.json` and `weights.safetensors`, or the name of a model that
            comes with the package.
        device: where to compute, as PyTorch names it.
        seed: seed of the exploration, for when `epsilon` is raised.
        frame_seconds: as `Policy` takes it.

    Raises:
        ModelError: the folder cannot be used; the text names the file and what is wrong.
    """
    model = load_model(find_model(folder))
    policy = Policy(model.description, device=device, seed=seed, frame_seconds=frame_seconds)
    policy.swap_weights(WeightsUpdate(model.tensors, model.description, model.version))
    return policy
