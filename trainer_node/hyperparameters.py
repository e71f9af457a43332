# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Every number that learning depends on, described once.

Section numbers are those of the report that the project starts from; papers are named where a
trick comes from one. Presets are YAML files of these names.
"""
from __future__ import annotations

import dataclasses
import math
import os
from pathlib import Path
from typing import Any

from dqn_policy_node.action_space import ACTION_SPACES, action_space, has_two_parts
from dqn_policy_node.model_description import (
    GRAYS, MAX_FRAME_SIDE, ModelDescription, Network, parse_convolutions, Preprocessing, ROADS,
)
from msgs_bridge.errors import SettingsError
from msgs_bridge.plain_text import plain
from msgs_bridge.regular_file import read_regular
from msgs_bridge.seeds import is_validation, TRAINING, training_seed, VALIDATION
from msgs_bridge.settings import from_mapping, setting
from msgs_bridge.share import share_folders, share_path
from msgs_bridge.simulator import FRAME_SECONDS
from msgs_bridge.yaml_text import dump_yaml, load_yaml
from trainer_node.learner import LEARNERS
from trainer_node.losses import LOSSES

MAX_PRESET_BYTES = 2**20


@dataclasses.dataclass(frozen=True)
class Hyperparameters:
    """The settings of one training run; the defaults are those of the report."""

    # What the agent is. ------------------------------------------------------------------------
    initial_model: str = setting(
        '', 'model whose weights a new run begins with: name of a shipped one, or a folder, its '
        'path seen from the run folder; empty: random weights')
    convolutions: str = setting(
        '32@8/4 64@4/2 64@3/1', 'convolutional layers as FILTERS@KERNEL/STRIDE (table 1)')
    hidden: int = setting(
        512, 'units of the fully connected layer (2.1)', low=2, high=4096)
    dueling: bool = setting(
        False, 'separate streams for value and advantage, half the hidden units each '
        '(arXiv 1511.06581)')
    dropout: float = setting(
        0.0, 'share of the second convolution dropped while learning (AMD-RIPS 2018)',
        low=0.0, high=0.9)
    gray: str = setting(
        'mean', 'how rgb becomes gray; the mean of the channels in the report (2.1)',
        choices=GRAYS)
    frame_height: int = setting(
        96, 'rows of a frame of the simulator', low=1, high=MAX_FRAME_SIDE)
    frame_width: int = setting(
        96, 'columns of a frame of the simulator', low=1, high=MAX_FRAME_SIDE)
    first_row: int = setting(
        0, 'first row of the frame that is kept', low=0, high=MAX_FRAME_SIDE - 1)
    rows: int = setting(
        0, 'rows that are kept; 0 = all from the first on', low=0, high=MAX_FRAME_SIDE)
    first_column: int = setting(
        0, 'first column of the frame that is kept', low=0, high=MAX_FRAME_SIDE - 1)
    columns: int = setting(
        0, 'columns that are kept; 0 = all from the first on', low=0, high=MAX_FRAME_SIDE)
    shrink: int = setting(
        1, 'side in pixels of the squares that are averaged into one', low=1, high=8)
    road: str = setting(
        'plain', 'how the faint shades of unvisited road are shown: as drawn, all in one shade '
        '(AMD-RIPS 2018 hid them, too), or with more contrast', choices=ROADS)
    frame_stack: int = setting(
        1, 'observations the network sees at once; the report names one (2.1)', low=1, high=16)
    action_space: str = setting(
        'seed5', 'what the outputs of the network mean; the five actions of the report are seed5 '
        '(2.2.2)', choices=tuple(ACTION_SPACES))
    tuner_series: int = setting(
        0, 'training episodes after which the share of those that are driven with the axes of a '
        'space, and not with its single commands, is moved to what earned more (5.2); 0 = each '
        'decision chooses from both', low=0, high=1_000_000)
    tuner_step: float = setting(
        0.1, 'by how much that share is moved', low=0.001, high=0.5)
    tuner_least: float = setting(
        0.1, 'least share of either of the two, so that both are known', low=0.0, high=0.5)
    frame_seconds: float = setting(
        FRAME_SECONDS, 'simulated seconds of one frame of the simulator', low=1e-4, high=1.0)
    action_repeat: int = setting(
        1, 'simulator frames an action is held while learning; the report names none',
        low=1, high=50)
    drive_repeat: int = setting(
        0, 'simulator frames an action is held in validation and by the finished model; '
        '0 = as in training', low=0, high=50)

    # What it learns from. ----------------------------------------------------------------------
    seed: int = setting(42, 'seed of training tracks, weights and samples (3.1)',
                        low=0, high=2**31 - 1)
    seed_each_episode: bool = setting(
        False, 'every training episode has a seed of its own, out of the space of training '
        '(msgs_bridge/seeds.py); without it they are the stream of one seed (3.1)')
    track_retries: int = setting(
        0, 'with seed_each_episode: how often a track is driven again at once on which the return '
        'was among the lowest tenth of the last 100 (arXiv 2010.03934)', low=0, high=100)
    simulator: str = setting(
        'carracing', 'simulator of the training episodes and of the validation: the name of an '
        'installed one, or module:Class')
    early_end_frames: int = setting(
        0, 'simulator frames without a new tile that end a training episode; 0 = never',
        low=0, high=100000)
    early_end_lap: bool = setting(
        False, 'end a training episode when the car has come round, whatever it missed')
    replay_capacity: int = setting(
        100_000, 'frames the replay buffer holds (2.2.1)', low=100, high=5_000_000)
    batch_size: int = setting(32, 'transitions in a batch (2.2.1)', low=1, high=4096)
    learning_starts: int = setting(
        1000, 'transitions before the first update', low=1, high=1_000_000)
    samples_per_transition: float = setting(
        8.0, 'samples drawn for every transition that comes in: 8 is a batch of 32 every fourth '
        'decision (Nature 518, 529)', low=0.01, high=1000.0)
    flips: bool = setting(
        False, 'mirror half of the samples left to right (AMD-RIPS 2018)')
    brightness: float = setting(
        0.0, 'share by which each sample is made brighter or darker at most, for cameras whose '
        'exposure changes; with road: plain only', low=0.0, high=0.9)

    demonstrations: str = setting(
        '', 'file of demonstrations, its path seen from the run folder; `carracing train '
        '--demonstrations` makes it from bags; empty: none')
    demonstration_share: float = setting(
        0.25, 'share of each batch that is drawn from demonstrations (arXiv 1909.01387)',
        low=0.0, high=0.9)
    demonstration_updates: int = setting(
        2000, 'updates from demonstrations alone before anything is driven', low=0,
        high=10_000_000)
    demonstration_margin: float = setting(
        0.8, 'by how much the value of a demonstrated action is to be above the others (arXiv '
        '1704.03732)', low=0.0, high=1000.0)
    demonstration_weight: float = setting(
        1.0, 'weight of the loss that sees to it; 0 = learn from demonstrations as from any '
        'transition', low=0.0, high=1000.0)

    # How it learns. ----------------------------------------------------------------------------
    learner: str = setting(
        'dqn', 'the algorithm: DQN (2.2.1) or quantile regression DQN (arXiv 1710.10044)',
        choices=tuple(LEARNERS))
    quantiles: int = setting(
        50, 'quantiles of the return of each action, for a learner that learns them; 200 in the '
        'paper', low=2, high=1024)
    gamma: float = setting(
        0.99, 'discount for each decision (2.2.1)', low=0.0, high=1.0)
    n_steps: int = setting(
        1, 'rewards added up before bootstrapping (arXiv 1710.02298)', low=1, high=50)
    double: bool = setting(
        False, 'the online network chooses, the target network judges (arXiv 1509.06461)')
    loss: str = setting('l1', 'loss of the TD error (2.2.1)', choices=tuple(LOSSES))
    gradient_clip: float = setting(
        10.0, 'largest norm of the gradient; the report clips at an unnamed value (2.2.1)',
        low=0.001, high=1e6)
    pixel_range: float = setting(
        1.0, 'what a white pixel is to the first layer: 1 scales images to 0..1, 255 leaves them '
        'as they are, with a layer that starts and learns as for such; the report says nothing '
        '(2.1)', low=0.01, high=1000.0)
    reward_scale: float = setting(
        1.0, 'factor on the shaped reward before learning', low=1e-6, high=1e6)
    adam_epsilon: float = setting(
        1e-8, "epsilon of Adam (PyTorch's)", low=1e-12, high=1.0)
    target_update: str = setting(
        'episodes', 'what the target network waits for (2.2.1: episodes)',
        choices=('episodes', 'updates'))
    target_every: int = setting(
        10, 'episodes or updates between copies to the target network (2.2.1)',
        low=1, high=1_000_000)
    weight_average: float = setting(
        0.0, 'decay for each update of the averaged weights that act and are validated; 0 = act '
        'by the last weights', low=0.0, high=0.999999)
    bf16: bool = setting(
        False, 'bfloat16 arithmetic in the network while learning; of a preset it is taken where '
        'the processor has it, for one that imitates it takes four times as long as in float32')
    flush_denormals: bool = setting(
        True, 'compute updates with numbers below 1.2e-38 as 0, for many processors take a '
        'hundred times as long over them')

    # Schedules. --------------------------------------------------------------------------------
    epsilon_schedule: str = setting(
        'episodes', 'epsilon falls by a factor each episode (2.2.1) or linearly by decisions',
        choices=('episodes', 'decisions'))
    epsilon_start: float = setting(1.0, 'first epsilon (2.2.1)', low=0.0, high=1.0)
    epsilon_end: float = setting(0.01, 'least epsilon (2.2.1)', low=0.0, high=1.0)
    epsilon_decay: float = setting(
        0.995, 'factor on epsilon after every episode (2.2.1)', low=0.0, high=1.0)
    epsilon_decisions: int = setting(
        100_000, 'decisions over which a linear epsilon falls', low=1, high=1_000_000_000)
    epsilon_spread: float = setting(
        7.0, 'of several cars, how much the exponent of epsilon of the last is above the 1 of the '
        'first (arXiv 1803.00933)', low=0.0, high=100.0)
    gas_weight: float = setting(
        1.0, 'how much likelier a random action has gas; 1 = uniform (2.2.1)',
        low=0.001, high=1000.0)
    exploration_hold: int = setting(
        1, 'most decisions for which a random action is held, its length drawn from a zeta '
        'distribution (arXiv 2006.01782)', low=1, high=1000)
    learning_rate: float = setting(1e-4, 'first learning rate (2.2.1)', low=1e-9, high=1.0)
    learning_rate_end: float = setting(1e-6, 'least learning rate (2.2.1)', low=0.0, high=1.0)
    learning_rate_schedule: str = setting(
        'plateau', 'halved when no episode was better for a while (2.2.3), the same and back to '
        'the first by a better one, constant, or linear over the later part of the run',
        choices=('plateau', 'plateau_reset', 'constant', 'linear'))
    patience_episodes: int = setting(
        200, 'episodes without a better reward before the learning rate is halved (2.2.3)',
        low=1, high=1_000_000)
    learning_rate_hold: float = setting(
        0.0, 'share of the run before a linear learning rate starts to fall', low=0.0, high=1.0)
    run_decisions: int = setting(
        0, 'decisions after which the run is complete; 0 = no limit', low=0, high=1_000_000_000)
    run_episodes: int = setting(
        2000, 'episodes after which the run is complete; 0 = no limit (3.1)',
        low=0, high=1_000_000_000)
    run_minutes: float = setting(
        0.0, 'minutes of wall clock after which the run is complete; 0 = no limit',
        low=0.0, high=1e6)

    # Shaping: in training only, added to the reward of the environment; 0 = off. ---------------
    tile_missed_penalty: float = setting(
        0.0, 'points off for every tile left behind unvisited', low=0.0, high=1000.0)
    tile_missed_limit: float = setting(
        1e6, 'most points off for tiles left behind in one decision; without a limit a car that '
        'has cut a bend had better not touch the road again', low=0.0, high=1e6)
    off_road_penalty: float = setting(
        0.0, 'points off a frame, times the share of the wheels off the road',
        low=0.0, high=100.0)
    standing_penalty: float = setting(
        0.0, 'points off for the first frame of standing still (5.1)', low=0.0, high=100.0)
    standing_growth: float = setting(
        1.02, 'factor by which the penalty grows with each frame of standing still (5.1)',
        low=1.0, high=2.0)
    standing_limit: float = setting(
        10.0, 'most points off for one frame of standing still', low=0.0, high=1000.0)
    progress_weight: float = setting(
        0.0, 'points for visiting all tiles, shared out by tile, beside the 1000 of the '
        'environment (5.1)', low=-1000.0, high=10000.0)
    position_weight: float = setting(
        0.0, 'points for driving once round the lap, shared out by tile and taken back for every '
        'tile driven the wrong way', low=0.0, high=10000.0)
    speed_weight: float = setting(
        0.0, 'points a frame, times the speed in m/s over 100 (5.1)', low=-10.0, high=10.0)
    time_penalty: float = setting(
        0.0, "points off a frame, beside the environment's 0.1", low=0.0, high=10.0)
    finish_bonus: float = setting(
        0.0, 'points for coming round, whatever was missed', low=0.0, high=1000.0)
    left_field_refund: float = setting(
        0.0, "points given back when the car leaves the field, of the environment's -100",
        low=0.0, high=200.0)
    early_end_penalty: float = setting(
        0.0, 'points off when the episode is ended early before the car has come round',
        low=0.0, high=1000.0)
    early_end_terminal: bool = setting(
        False, 'treat an early end as the end of all rewards instead of bootstrapping')
    truncated_terminal: bool = setting(
        False, 'treat every end of an episode as that of all rewards, the limit of its frames '
        'too, as code does that keeps one flag for both')

    # What is handed out and kept. --------------------------------------------------------------
    weights_every: int = setting(
        100, 'updates between published weights', low=1, high=1_000_000)
    validation_seed: int = setting(
        420, 'seed of the first validation track (3.1)', low=0, high=2**31 - 1)
    validation_tracks: int = setting(
        5, 'laps of a validation (3.1)', low=1, high=1000)
    validation_every_episodes: int = setting(
        100, 'episodes between validations; 0 = not by episodes (3.1)', low=0, high=1_000_000)
    validation_every_decisions: int = setting(
        0, 'decisions between validations; 0 = not by decisions', low=0, high=1_000_000_000)
    validation_every_minutes: float = setting(
        0.0, 'minutes between validations; 0 = not by the clock', low=0.0, high=1e6)
    validation_spread_weight: float = setting(
        0.0, 'standard deviations taken off the mean when the best model is chosen',
        low=0.0, high=10.0)
    checkpoint_every_minutes: float = setting(
        1.0, 'minutes between checkpoints; 0 = only at the end', low=0.0, high=1e6)

    def __post_init__(self) -> None:
        """
        Check what concerns more than one value.

        Raises:
            ModelError: the network or the preprocessing cannot be.
            SettingsError: values that contradict each other.
        """
        self.model_description()
        if self.tuner_series and not has_two_parts(action_space(self.action_space)):
            raise SettingsError(
                f'tuner_series is {self.tuner_series}, but {self.action_space!r} has not both '
                'single commands and axes; those that have: '
                + ', '.join(name for name, space in ACTION_SPACES.items() if has_two_parts(space)))
        if self.demonstrations and self.demonstration_weight and not LEARNERS[self.learner].margin:
            raise SettingsError(
                f'learner {self.learner!r} knows no margin of demonstrations; those that do: '
                + ', '.join(name for name, entry in LEARNERS.items() if entry.margin)
                + '; without it: demonstration_weight=0')
        if self.brightness and self.road != 'plain':
            raise SettingsError(
                f'brightness is {self.brightness:g}, but road: {self.road} reads exact levels, '
                'which other brightness moves; road: plain goes with it')
        if self.epsilon_end > self.epsilon_start:
            raise SettingsError(f'epsilon_end {self.epsilon_end} is above epsilon_start '
                                f'{self.epsilon_start}')
        if self.learning_rate_end > self.learning_rate:
            raise SettingsError(f'learning_rate_end {self.learning_rate_end} is above '
                                f'learning_rate {self.learning_rate}')
        if self.seed_each_episode and not is_validation(
                self.validation_seed, self.validation_tracks):
            raise SettingsError(
                f'validation_seed {self.validation_seed} and the {self.validation_tracks} tracks '
                f'from it on must lie from {VALIDATION} to {TRAINING - 1}, where nothing else '
                'draws (msgs_bridge/seeds.py)')
        if self.track_retries and not self.seed_each_episode:
            raise SettingsError(f'track_retries is {self.track_retries}, but a stream of tracks '
                                'never comes back to one; seed_each_episode: true goes with it')
        if self.learning_starts >= self.replay_capacity:
            raise SettingsError(f'learning_starts {self.learning_starts} must be below '
                                f'replay_capacity {self.replay_capacity}')
        if self.frame_stack + self.n_steps >= self.replay_capacity:
            raise SettingsError('frame_stack and n_steps do not fit into replay_capacity')

    def simulator_parameters(self, car: int | None = None) -> dict[str, Any]:
        """
        Return the parameters of the simulator that training episodes are driven in.

        Args:
            car: number of the car if there are several: each has seeds of its own then.
        """
        of_episode = self.seed_each_episode or car is not None
        return {
            'action_repeat': self.action_repeat,
            'seed': training_seed(self.seed, car or 0) if of_episode else self.seed,
            'seed_each_episode': of_episode,
            'simulator': self.simulator,
            # other simulators may not know all of them
            **{name: value for name in ('early_end_frames', 'early_end_lap', 'track_retries')
               if (value := getattr(self, name))}}

    @property
    def validation_seeds(self) -> range:
        """Return the seeds of the validation tracks."""
        return range(self.validation_seed, self.validation_seed + self.validation_tracks)

    @property
    def validates(self) -> bool:
        """Return whether anything is ever validated."""
        return bool(self.validation_every_episodes or self.validation_every_decisions
                    or self.validation_every_minutes)

    def for_recorded(self, transitions: int) -> Hyperparameters:
        """
        Return the settings of a run whose length is that of a recording instead of a time.

        What goes by minutes of a run goes by its share of the transitions then, so that what is
        learned is a function of the recording.

        Args:
            transitions: how many there are.
        """
        if not self.run_minutes:
            return self
        return self.without_clock(self.run_decisions or transitions)

    def without_clock(self, decisions: int) -> Hyperparameters:
        """
        Return the settings of a run of so many decisions in which nothing goes by the clock.

        What went by minutes of the run goes by its share of the decisions.

        Args:
            decisions: after which it is complete.

        Raises:
            SettingsError: validations go by minutes of a run that has none.
        """
        if self.validation_every_minutes and not self.run_minutes:
            raise SettingsError(
                'validation_every_minutes without run_minutes is no share of the run; set '
                'validation_every_decisions instead')
        every = 0
        if self.validation_every_minutes:
            every = math.ceil(self.validation_every_minutes / self.run_minutes * decisions)
        return dataclasses.replace(
            self, run_minutes=0.0, run_decisions=decisions, validation_every_minutes=0.0,
            validation_every_decisions=self.validation_every_decisions or every)

    def model_description(self) -> ModelDescription:
        """
        Return the model that these settings make; `settings_of_model` is the reverse.

        Raises:
            ModelError: it cannot be.
        """
        return ModelDescription(
            network=Network(
                parse_convolutions(self.convolutions), self.hidden, self.dueling, self.dropout,
                self.quantiles if LEARNERS[self.learner].quantiles else 1),
            preprocessing=Preprocessing(
                self.frame_height, self.frame_width, self.first_row,
                self.rows or self.frame_height - self.first_row, self.first_column,
                self.columns or self.frame_width - self.first_column, self.gray, self.road,
                self.shrink),
            frame_stack=self.frame_stack,
            action_space=action_space(self.action_space),
            action_seconds=(self.drive_repeat or self.action_repeat) * self.frame_seconds,
            stack_seconds=self.action_repeat * self.frame_seconds,
        )


def settings_of_model(description: ModelDescription, frame_seconds: float) -> dict[str, Any]:
    """
    Return the hyperparameters that make a model again for a simulator, by name.

    Args:
        description: the model. The part of the frame that it looks at counts where it is not all
            of it.
        frame_seconds: of the simulator.

    Raises:
        SettingsError: its action space has no name here.
    """
    network, seen = description.network, description.preprocessing
    name = description.action_space.name
    if ACTION_SPACES.get(name) != description.action_space:
        raise SettingsError(f'its actions {name!r} are none of {", ".join(ACTION_SPACES)}')
    quantiles = {} if network.quantiles == 1 else {
        'learner': next(name for name, entry in LEARNERS.items() if entry.quantiles),
        'quantiles': network.quantiles}
    part = ('first_row', 'rows', 'first_column', 'columns')
    whole = (seen.rows, seen.columns) == (seen.frame_height, seen.frame_width)
    return {
        'convolutions': ' '.join(
            f'{layer.filters}@{layer.kernel}/{layer.stride}' for layer in network.convolutions),
        **{name: getattr(network, name) for name in ('hidden', 'dueling', 'dropout')},
        **quantiles,
        **{name: 0 if whole else getattr(seen, name) for name in part},
        **{name: getattr(seen, name) for name in ('gray', 'road', 'shrink')},
        'frame_stack': description.frame_stack,
        'action_space': name,
        'action_repeat': max(round(description.stack_seconds / frame_seconds), 1),
        'drive_repeat': max(round(description.action_seconds / frame_seconds), 1),
    }


def load_preset(
    name_or_path: str | Path, overrides: dict[str, Any] | None = None,
) -> Hyperparameters:
    """
    Read hyperparameters from a YAML file.

    Args:
        name_or_path: a preset of the package ('report', 'racing') or the path of a file.
        overrides: values that take the place of the file's.

    Raises:
        SettingsError: no such preset, a file that is no mapping, or a name or value that is not
            accepted.
    """
    path = Path(os.path.expanduser(name_or_path))
    # a name may be none that a file can have
    if not os.path.isfile(path):
        try:
            path = share_path(Path('config') / f'{name_or_path}.yaml')
        except OSError:
            raise SettingsError(f'no preset {plain(name_or_path)!r}: neither a file nor one of '
                                f"the package's, which are {', '.join(preset_names())}") from None
    text = read_regular(path, MAX_PRESET_BYTES, SettingsError).decode('utf-8', 'replace')
    values = load_yaml(text, str(path), SettingsError)
    if values is None:
        values = {}
    if not isinstance(values, dict):
        raise SettingsError(f'{path} must be a mapping of names to values')
    try:
        return from_mapping(Hyperparameters, {**values, **(overrides or {})})
    except SettingsError as error:
        raise SettingsError(f'{path}: {error}') from None


def preset_names() -> list[str]:
    """Return the names of the presets that come with the package."""
    return sorted({path.stem for folder in share_folders()
                   for path in (folder / 'config').glob('*.yaml')})


def to_yaml(hyperparameters: Hyperparameters) -> str:
    """Return a preset file that holds every value."""
    return dump_yaml(dataclasses.asdict(hyperparameters))
