# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The annotated picture is painted while somebody takes it, and costs nobody anything else."""
from msgs_bridge import topics
from msgs_bridge.images import image_to_array


def test_it_paints_only_while_somebody_subscribes(graph):
    graph.listen(topics.DIAGNOSTICS)
    graph.node('carracing_dqn.watch.annotator_node', 'annotator', scale=2)
    graph.node('dqn_policy_node', 'policy', model='racing')
    graph.node('carracing_sim_node', 'simulator', stepping='real_time')
    graph.spin_until(lambda: graph.health('dqn_policy_node').get('summary') == 'driving', 90,
                     'a drive')
    count = graph.probe.count_subscribers
    graph.spin_until(lambda: graph.health('image_annotator_node').get('summary') == 'nobody looks',
                     20, 'the annotator')
    # the policy alone
    assert count('image_raw') == 1 and count('q_values') == 0 and count('step') == 0

    graph.listen(topics.IMAGE_ANNOTATED)
    pictures = graph.messages[topics.IMAGE_ANNOTATED.name]
    graph.spin_until(lambda: len(pictures) > 5, 30, 'pictures')
    pixels = image_to_array(pictures[-1])
    assert pixels.shape[1] > 2 * 96 and pixels.shape[0] >= 2 * 96
    # numbers and bars beside the picture
    assert len({tuple(one) for one in pixels[:, 2 * 96:].reshape(-1, 3)}) > 5
    for subscription in list(graph.probe.subscriptions):
        if subscription.topic_name.endswith(topics.IMAGE_ANNOTATED.name):
            graph.probe.destroy_subscription(subscription)
    graph.spin_until(lambda: count('image_raw') == 1 and count('step') == 0, 20, 'peace')
