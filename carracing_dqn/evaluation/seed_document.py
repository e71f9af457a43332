# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
What the document states that the project starts from: every figure, as data with its section.

"Deep Q-Learning for Autonomous Racing: Implementation and Analysis in CarRacing-v3".
"""
from __future__ import annotations

import dataclasses

TITLE = 'Deep Q-Learning for Autonomous Racing: Implementation and Analysis in CarRacing-v3'
SHORT_NAME = 'seed document'

TRAINING, VALIDATION, DUMMY, TRAINED, SETTINGS = (
    'Training', 'Validation', 'Dummy agent, test laps', 'Trained agent, test laps', 'Settings')


@dataclasses.dataclass(frozen=True)
class Figure:
    """
    One stated figure.

    Attributes:
        key: how `comparison.measure` knows it.
        group: which part of the table it belongs to.
        section: of the document.
        label: what it is.
        stated: as the document puts it.
        unit: of the value, empty for none.
        value: as a number; None where the document gives only words.
    """

    key: str
    group: str
    section: str
    label: str
    stated: str
    unit: str = ''
    value: float | None = None


@dataclasses.dataclass(frozen=True)
class Objective:
    """
    One objective of section 1.2.

    Attributes:
        key: how `comparison.judge` knows it.
        text: as the document puts it.
        reading: what it is judged by, where the text leaves room.
    """

    key: str
    text: str
    reading: str


OBJECTIVES = (
    Objective('consecutive', 'Achieve a reward of 700 over 100 consecutive episodes.',
              'mean of the first 100 test laps in a row is at least 700'),
    Objective('average', 'Achieve an average reward of 800+ over 100 episodes.',
              'mean of at least 100 test laps is at least 800'),
    Objective('improvement', 'Show improvement in reward gain overtime during training.',
              'mean of the last tenth of the training episodes (100 at most) is above that of '
              'the first'),
    Objective('baseline', 'Demonstrate at least a 50% increase in reward compared to the '
              'baseline agent.',
              'the test mean is above the mean of the dummy agent by at least half of its '
              'absolute value'),
)

FIGURES = (
    # 3.2.1, figure 1
    Figure('train_first', TRAINING, '3.2.1', 'reward of the first episode', '-54', 'points', -54),
    Figure('train_average_zero', TRAINING, '3.2.1',
           'episode at which the moving average passes 0', '~150', 'episodes', 150),
    Figure('train_average_800', TRAINING, '3.2.1',
           'episode at which the moving average passes 800', '~700', 'episodes', 700),
    Figure('train_average_last', TRAINING, '3.2.1', 'moving average at the end', '850',
           'points', 850),
    Figure('train_maximum', TRAINING, '3.2.1', 'best reward of an episode', '946.30', 'points',
           946.30),
    Figure('train_maximum_episode', TRAINING, '3.2.1', 'episode of the best reward', '~1857',
           'episodes', 1857),
    Figure('train_dips', TRAINING, '3.2.1', 'lowest reward after the best', 'never below 0',
           'points', 0),
    Figure('train_last', TRAINING, '3.2.1', 'reward of the last episode', '845.85', 'points',
           845.85),
    Figure('train_mean', TRAINING, '3.2.1', 'mean of all episodes', '704.44', 'points', 704.44),
    Figure('episodes', TRAINING, '3.1', 'episodes', '2000', 'episodes', 2000),
    Figure('hours', TRAINING, '3.1', 'training time', '16.6 h on a 7900XTX GPU', 'h', 16.6),
    # 3.2.2, figure 2
    Figure('validation_first', VALIDATION, '3.2.2', 'first validation', '-54', 'points', -54),
    Figure('validation_700', VALIDATION, '3.2.2', 'validation at episode 700', '769.73',
           'points', 769.73),
    Figure('validation_above_800', VALIDATION, '3.2.2',
           'episode from which on all are above 800', '700', 'episodes', 700),
    Figure('validation_maximum', VALIDATION, '3.2.2', 'best validation', '910.23', 'points',
           910.23),
    Figure('validation_maximum_episode', VALIDATION, '3.2.2', 'episode of the best validation',
           '1300', 'episodes', 1300),
    Figure('validation_last', VALIDATION, '3.2.2', 'last validation', '807.82', 'points',
           807.82),
    Figure('validation_mean', VALIDATION, '3.2.2', 'mean of all validations', '640.31',
           'points', 640.31),
    # 3.2.3 to 3.2.5, figures 3 to 6
    Figure('dummy_mean', DUMMY, '3.2.3', 'mean', '-93.13', 'points', -93.13),
    Figure('dummy_std', DUMMY, '3.2.3', 'standard deviation', '0.49', 'points', 0.49),
    Figure('dummy_minimum', DUMMY, '3.2.3', 'minimum', '-93.30', 'points', -93.30),
    Figure('dummy_maximum', DUMMY, '3.2.3', 'maximum', '-91.30', 'points', -91.30),
    Figure('dummy_completed', DUMMY, '3.2.4', 'laps finished', '0 %', '%', 0),
    Figure('dummy_700', DUMMY, '3.2.5', 'success at 700', 'none', '%', 0),
    Figure('dummy_800', DUMMY, '3.2.5', 'success at 800', 'none', '%', 0),
    Figure('dummy_900', DUMMY, '3.2.5', 'success at 900', 'none', '%', 0),
    Figure('test_episodes', TRAINED, '3.2.3', 'test laps', '100', 'laps', 100),
    Figure('test_mean', TRAINED, '3.2.3', 'mean', '855.74', 'points', 855.74),
    Figure('test_std', TRAINED, '3.2.3', 'standard deviation', '141.07', 'points', 141.07),
    Figure('test_minimum', TRAINED, '3.2.3', 'minimum', '181.90', 'points', 181.90),
    Figure('test_maximum', TRAINED, '3.2.3', 'maximum', '940.50', 'points', 940.50),
    Figure('test_completed', TRAINED, '3.2.4', 'laps finished', '40 %', '%', 40),
    Figure('test_frames', TRAINED, '3.2.4', 'mean steps of an episode', '683', 'frames', 683),
    Figure('test_700', TRAINED, '3.2.5', 'success at 700', '"extremely high rate"', '%'),
    Figure('test_800', TRAINED, '3.2.5', 'success at 800', '"a similar success rate"', '%'),
    Figure('test_900', TRAINED, '3.2.5', 'success at 900', '"significantly lower"', '%'),
    Figure('test_stopped', TRAINED, '4.1.1',
           'laps in which it stops driving (over 100 frames still at the end)',
           '"typically", score 820-850', '%'),
    Figure('test_increase', TRAINED, '1.2', 'increase over the dummy agent', 'at least 50 %',
           '%', 50),
    # 2 and 3.1
    Figure('config.replay_capacity', SETTINGS, '2.2.1', 'replay buffer', '100000', 'frames',
           100_000),
    Figure('config.batch_size', SETTINGS, '2.2.1', 'batch', '32', 'transitions', 32),
    Figure('config.gamma', SETTINGS, '2.2.1', 'gamma', '0.99', '', 0.99),
    Figure('config.target_every', SETTINGS, '2.2.1', 'target network updated every',
           '10 episodes', '', 10),
    Figure('config.learning_rate', SETTINGS, '2.2.1', 'first learning rate', '1e-04', '', 1e-4),
    Figure('config.learning_rate_end', SETTINGS, '2.2.1', 'least learning rate', '1e-06', '',
           1e-6),
    Figure('learning_rate_last', SETTINGS, '2.2.1', 'last learning rate', '6.25e-06', '',
           6.25e-6),
    Figure('config.patience_episodes', SETTINGS, '2.2.3',
           'patience before the learning rate is halved', '200', 'episodes', 200),
    Figure('config.epsilon_start', SETTINGS, '2.2.1', 'first epsilon', '1.0', '', 1.0),
    Figure('config.epsilon_decay', SETTINGS, '2.2.1', 'decay of epsilon for each episode',
           '0.995', '', 0.995),
    Figure('config.epsilon_end', SETTINGS, '2.2.1', 'least epsilon', '0.01', '', 0.01),
    Figure('config.seed', SETTINGS, '3.1', 'seed of training', '42', '', 42),
    Figure('config.validation_seed', SETTINGS, '3.1', 'seed of validation', '420', '', 420),
    Figure('config.validation_every_episodes', SETTINGS, '3.1', 'validation every', '100',
           'episodes', 100),
    Figure('config.validation_tracks', SETTINGS, '3.1', 'laps of a validation', '5', 'laps', 5),
)

STATED = {figure.key: figure.value for figure in FIGURES if figure.value is not None}
"""Key -> number, for lines and points in figures."""
