# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Names of the values that travel in JointState bundles, each described once."""

STEP_FIELDS = {
    'reward': "the environment's own reward since the frame before, summed over repeated frames",
    'terminated': '1 on the last frame of an episode that ended by the rules (lap or field left)',
    'truncated': '1 on the last frame of an episode that was cut off (frames or early end)',
    'lap_finished': '1 when all tiles were visited',
    'left_field': '1 when the car left the playfield',
    'ended_early': '1 when an early-end variant cut the episode',
    'came_round': '1 when the car is back at the start, whatever it missed',
    'episode': 'number of the episode, from 0',
    'seed': 'seed of the track; -1 when it came from the stream of the first seed',
    'decision': 'number of the published frame within its episode, from 0 (the reset frame)',
    'step': 'simulator frames (1/50 s) since the start of the episode',
    'episode_return': 'sum of rewards so far in the episode',
    'tiles_visited': 'tiles visited so far',
    'tiles_total': 'tiles of the track',
    'tiles_missed': 'tiles left behind unvisited',
    'lap_position': 'tile under the foremost wheel, counted on from the start and not wrapped',
    'wheels_off_road': 'share of the wheels that touch no road tile, 0 to 1',
    'speed': 'speed over ground in units of the physics per second (about m/s)',
    'standing_still': 'simulator frames in a row the car has stood still',
    'steer': 'steering applied since the frame before, -1 (left) to 1 (right)',
    'gas': 'gas applied since the frame before, 0 to 1',
    'brake': 'brake applied since the frame before, 0 to 1',
    'applied_sec': 'seconds of the stamp of the twist applied; -1 when none was',
    'applied_nanosec': 'nanoseconds of that stamp',
    'frames': 'simulator frames since the frame before (less than action_repeat at an end)',
    'zoom': '1 with the first-second zoom of the environment, 0 in the variant without',
    'domain_randomize': '1 in the variant with random colours',
    'early_end_frames': 'frames without a new tile that end an episode; 0 = never',
    'early_end_lap': '1 in the variant that ends an episode when the car has come round',
}

EPISODE_FIELDS = {
    'episode': 'number of the episode, from 0',
    'seed': 'seed of its track; -1 when the track came from the stream of the first seed',
    'episode_return': 'sum of rewards',
    'frames': 'simulator frames',
    'decisions': 'frames published after the reset frame',
    'lap_finished': '1 when all tiles were visited',
    'left_field': '1 when the car left the playfield',
    'ended_early': '1 when an early-end variant cut it',
    'terminated': '1 when it ended by the rules',
    'truncated': '1 when it was cut off',
    'tiles_visited': 'tiles visited',
    'tiles_total': 'tiles of the track',
    'standing_still': 'simulator frames the car had stood still in a row when it ended',
    'unanswered': 'frames that no twist answered in time',
}

VALIDATION_FIELDS = {
    'version': 'version of the weights that drove',
    'episodes': 'laps driven',
    'mean': 'mean return',
    'std': 'standard deviation of the returns (population)',
    'minimum': 'lowest return',
    'maximum': 'highest return',
    'completed': 'share of laps with all tiles visited, 0 to 1',
    'seconds': 'wall time it took',
}

Q_VALUE_EXTRAS = {
    'chosen': 'index of the action that was sent',
    'explored': '1 when it was drawn at random',
    'weights_version': 'version of the weights that computed them',
}
