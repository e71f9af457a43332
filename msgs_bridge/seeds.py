# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Seeds of episodes: training, validation and test draw from spaces that cannot meet.

| space | seeds | who draws |
|---|---|---|
| test | 0 to 2^20 - 1 | `carracing evaluate`, `carracing run` |
| validation | 2^20 to 2^21 - 1 | `validation_node`, to choose the best weights |
| training | from 2^21 on | the simulators of a training, by run, car and episode |

The preset `report` stays with the seeds of its document: 42 begins gymnasium's own stream of
random tracks, which are of no seed of their own, and 420 is the first validation track.
"""
from __future__ import annotations

TEST = 0
VALIDATION = 2**20
TRAINING = 2**21

MAX_CARS = 1024
# a car that has driven more episodes than this goes on with those of the next one
EPISODES_OF_A_CAR = 2**20
# first tracks of neighbouring runs lie so far apart, which is more than a run of hours drives
_RUNS_APART = 10_007


def training_seed(run_seed: int, car: int = 0) -> int:
    """
    Return the seed of the first training episode of a car; each further episode adds 1.

    Args:
        run_seed: seed of the run; runs of different seeds begin on different tracks.
        car: number of the car, 0 to `MAX_CARS` - 1.

    Raises:
        ValueError: a number of a car that is out of range.
    """
    if not 0 <= car < MAX_CARS:
        raise ValueError(f'car {car}; accepted: 0 to {MAX_CARS - 1}')
    return TRAINING + car * EPISODES_OF_A_CAR + run_seed * _RUNS_APART % EPISODES_OF_A_CAR


def epsilon_exponent(car: int, cars: int, spread: float) -> float:
    """
    Return what a car raises epsilon to, so that some explore more and others less.

    As in Ape-X (arXiv 1803.00933, section 4): epsilon ** (1 + spread * car / (cars - 1)), with a
    spread of 7 there. A car that joins beyond those counted on is like the last of them.

    Args:
        car: its number, from 0.
        cars: how many there are.
        spread: how much the exponent of the last car is above that of the first.
    """
    return 1.0 + spread * min(car / max(cars - 1, 1), 1.0)


def is_validation(first: int, count: int) -> bool:
    """Return whether `count` seeds from `first` on all lie in the space of validations."""
    return first >= VALIDATION and first + count <= TRAINING
