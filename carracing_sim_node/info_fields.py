# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What CarRacing adds to `step` and `episode`, each name described once."""

STEP_INFO = {
    'lap_finished': '1 when all tiles were visited',
    'left_field': '1 when the car left the playfield',
    'ended_early': '1 when an early-end variant cut the episode',
    'came_round': '1 when the car is back at the start, whatever it missed',
    'tiles_visited': 'tiles visited so far',
    'tiles_total': 'tiles of the track',
    'tiles_missed': 'tiles left behind unvisited',
    'lap_position': 'tile under the foremost wheel, counted on from the start and not wrapped',
    'wheels_off_road': 'share of the wheels that touch no road tile, 0 to 1',
    'speed': 'speed over ground in units of the physics per second (about m/s)',
    'standing_still': 'simulated frames (1/50 s) in a row the car has stood still',
    'steer': 'what CarRacing made of the command: steering, -1 (left) to 1 (right)',
    'gas': 'gas, 0 to 1',
    'brake': 'brake, 0 to 1',
}

CONSTANTS = {
    'zoom': '1 with the first-second zoom of the environment, 0 in the variant without',
    'domain_randomize': '1 in the variant with random colours',
    'early_end_frames': 'frames without a new tile that end an episode; 0 = never',
    'early_end_lap': '1 in the variant that ends an episode when the car has come round',
    'max_episode_frames': 'frames after which an episode is truncated',
}
