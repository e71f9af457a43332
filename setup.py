# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The ament_python package; what `ros2 run` and `carracing` start is listed here."""
from pathlib import Path
from xml.etree import ElementTree

from setuptools import setup

NAME = 'carracing_dqn'
# colcon --symlink-install runs a link to this file from its build folder
HERE = Path(__file__).resolve().parent
README = HERE / 'README.md'
# the one place of the version; ROS reads it there
VERSION = ElementTree.parse(HERE / 'package.xml').findtext('version')
PACKAGES = [
    'msgs_bridge', 'msgs_bridge.transport', 'carracing_sim_node', 'dqn_policy_node',
    'trainer_node', 'bags', 'carracing_dqn',
    'carracing_dqn.bringup', 'carracing_dqn.evaluation', 'carracing_dqn.simulation',
    'carracing_dqn.simulators', 'carracing_dqn.studies', 'carracing_dqn.teleop',
    'carracing_dqn.watch', 'carracing_dqn.benchmarks',
]
EXECUTABLES = (
    'carracing', 'carracing_sim_node', 'dqn_policy_node', 'trainer_node', 'validation_node',
    'bag_recorder_node', 'bag_player_node', 'gymnasium_sim_node', 'mujoco_robot_node',
    'referee_node', 'image_annotator_node', 'teleop_node', 'race_node',
)
SHARED = ('launch', 'config', 'models', 'layouts')


def shared_files():
    """Return data_files entries that lay the shared folders below share/carracing_dqn."""
    for folder in SHARED:
        for path in sorted(Path(folder).rglob('*')):
            if path.is_file() and '__pycache__' not in path.parts:
                yield f'share/{NAME}/{path.parent}', [str(path)]


setup(
    name=NAME,
    version=VERSION,
    description='A ROS 2 stack that learns to race',
    long_description=README.read_text(encoding='utf-8'),
    long_description_content_type='text/markdown',
    license='Apache-2.0',
    maintainer='The carracing_dqn authors',
    maintainer_email='maintainers@carracing-dqn.org',
    packages=PACKAGES,
    package_data={
        'carracing_dqn.evaluation': ['*.html', '*.j2', '*.css'],
        'carracing_dqn.watch': ['*.html', '*.css', '*.js'],
    },
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        *shared_files(),
    ],
    python_requires='>=3.10',
    install_requires=[
        'setuptools',
        'gymnasium[box2d]==1.4.0',
        'imageio[pyav]',
        'jinja2',
        'lz4',
        'matplotlib',
        'mcap',
        'numba',
        'numpy',
        'pillow',
        'pyyaml',
        'rich',
        'rosbags',
        'safetensors',
        'textual',
        'torch',
        'zstandard',
    ],
    extras_require={
        # rclpy and the messages as wheels, for machines without an installed ROS
        'wheels': ['ros-jazzy-rclpy[fastrtps]', 'ros-jazzy-common-interfaces'],
        'test': [
            'colcon-core', 'colcon-ros', 'hypothesis', 'mcap-ros2-support', 'onnx', 'onnxruntime',
            'pytest', 'ruff'],
        # `carracing export`
        'onnx': ['onnx', 'onnxruntime'],
        # to look at the pages of `carracing watch` as a browser shows them
        'browser': ['playwright'],
        # `carracing view`
        'rerun': ['rerun-sdk'],
        'tensorboard': ['tensorboard'],
        # `carracing study` with the sampler tpe
        'search': ['optuna'],
        # `make docs`
        'docs': ['furo', 'myst-parser', 'sphinx'],
        # simulators that others wrote
        'highway': ['highway-env'],
        'mujoco': ['mujoco'],
        'bench': ['envpool', 'mcap-ros2-support', 'stable-baselines3'],
    },
    zip_safe=True,
    entry_points={
        'console_scripts': [
            f'{name} = carracing_dqn.bringup.start:{name}' for name in EXECUTABLES
        ],
    },
)
