# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Find out whether a bag is whole, and whether it is what happened."""
from __future__ import annotations

from collections import Counter
import dataclasses
import math
from typing import Any

from bags.topic_lookup import find_topic
from bags.reader import BagReader
from bags.resimulate import Resimulation, Resimulator
from bags.integrity import order_notes, structure_problems
from bags.transitions import bag_transitions
from msgs_bridge.topics import IMAGE, STEP
from msgs_bridge.transitions import Transition
from msgs_bridge.twists import Command

# what the joiner counts: what is missing is wrong, the rest unusual
MISSING = {'lost_image': 'an image', 'lost_twist': 'the twist that was applied',
           'no_image': 'an image, of which there is none', 'no_twist': 'a twist, of which there '
           'is none', 'lost_step': 'a step'}
WRONG = {'twofold': 'transitions have different messages of one stamp, as when two publish',
         'after_end': 'steps come after the end of their episode'}
UNUSUAL = ('duplicate', 'odd_step', 'rewound')
LATE = ('lost_twist', 'lost_image', 'no_twist', 'no_image')


@dataclasses.dataclass
class Verification:
    """
    What a check of a bag found.

    Attributes:
        messages: in the bag.
        problems: what is wrong, each a sentence; the bag is good if there are none.
        notes: what is unusual but not wrong.
        transitions: the joiner's counts; empty if the bag has no images and steps.
        resimulation: what came of driving it again; None if it was not.
    """

    messages: int
    problems: list[str]
    notes: list[str]
    transitions: dict[str, int]
    resimulation: Resimulation | None

    @property
    def good(self) -> bool:
        """Return whether nothing is wrong."""
        return not self.problems

    def as_dict(self) -> dict[str, Any]:
        """Return it as JSON can hold it."""
        return {'good': self.good, **dataclasses.asdict(self)}


def verify_bag(
    reader: BagReader, *, namespace: str = '', resimulate: bool = True,
    simulator: str | None = None,
) -> Verification:
    """
    Check a bag: its files, the transitions in it, and a second drive of its actions.

    Args:
        reader: the bag.
        namespace: where the topics of the car are; needed if there are several.
        resimulate: whether to drive it again.
        simulator: in what; None for what the bag names.

    Raises:
        BagError: a bag that cannot be read at all.
        SimulatorError: there is no such simulator, or it cannot go on.
    """
    problems = structure_problems(reader)
    notes = order_notes(reader)
    driven: Resimulation | None = None
    counts: Counter[str] = Counter()
    # what is damaged cannot be driven again
    if not problems:
        if (find_topic(reader, IMAGE, namespace=namespace)
                and find_topic(reader, STEP, namespace=namespace)):
            found, unusual = _transition_findings(reader, namespace, counts)
            problems += found
            notes += unusual
            if resimulate:
                driven = Resimulator(
                    reader, namespace=namespace, simulator=simulator).run()
                if driven.rejected:
                    problems.append(f'{driven.rejected} messages of episode cannot be used')
                problems += driven.partings
                if driven.missing_images:
                    problems.append(f'{driven.missing_images} of {driven.frames} frames that '
                                    'were driven again have no image to compare')
                hidden = driven.differing_frames - len(driven.partings)
                if hidden > 0:
                    problems.append(f'{hidden} more frames differ')
                notes += [f'{count} episodes not driven again: {reason}'
                          for reason, count in driven.skipped.items()]
        else:
            notes.append('no images and steps of a simulator: nothing was compared with a drive')
    return Verification(
        reader.message_count, problems, notes, {key: count for key, count in counts.items()
                                                if count}, driven)


def _transition_findings(
    reader: BagReader, namespace: str, counts: Counter[str],
) -> tuple[list[str], list[str]]:
    """Return what is wrong with the transitions of a bag, and what is unusual."""
    problems, notes = [], []
    begun_late, unlike, first = None, 0, None
    for transition in bag_transitions([reader.path], namespace=namespace, counts=counts):
        if begun_late is None:
            # a recorder hears of the topics one after another
            begun_late = sum(counts[name] for name in LATE)
            for name in LATE:
                counts[name] = 0
        if not _as_applied(transition):
            unlike += 1
            first = first or transition.step
    if begun_late:
        notes.append(f'{begun_late} transitions at the start lack an image or a twist: '
                     'their topics were recorded later')
    problems += [f'{counts[name]} transitions lack {what}'
                 for name, what in MISSING.items() if counts[name]]
    problems += [f'{counts[name]} {what}' for name, what in WRONG.items() if counts[name]]
    if counts['rejected']:
        problems.append(f'{counts["rejected"]} messages cannot be used')
    if first is not None:
        problems.append(f'{unlike} twists are not what step says was applied, the first before '
                        f'episode {first.episode}, decision {first.decision}')
    notes += [f'{counts[name]} x {name} when joining transitions'
              for name in UNUSUAL if counts[name]]
    return problems, notes


def _as_applied(transition: Transition) -> bool:
    """Return whether its twist is what `step` says was applied, where it says it."""
    said = [transition.step.info.get(name) for name in Command._fields]
    # of bags of version 1 it is computed back from steer, gas and brake
    return None in said or all(
        math.isclose(one, other, abs_tol=1e-6)
        for one, other in zip(transition.command.clamped(), said))
