# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
The wheel forces of one frame, equal to gymnasium's `Car.step` to the last bit.

`gymnasium.envs.box2d.car_dynamics.Car.step` spends two thirds of its time in NumPy calls on single
numbers and in asking Box2D for vectors one coordinate at a time. This is the same arithmetic, in
the same order, on Python floats: `math.sqrt` rounds as `numpy.sqrt` does, and the two axes of a
wheel are its rotation's own sine and cosine.
"""

from math import sqrt

from gymnasium.envs.box2d.car_dynamics import ENGINE_POWER
from gymnasium.envs.box2d.car_dynamics import FRICTION_LIMIT
from gymnasium.envs.box2d.car_dynamics import SIZE
from gymnasium.envs.box2d.car_dynamics import WHEEL_MOMENT_OF_INERTIA
from gymnasium.envs.box2d.car_dynamics import Car

_STIFFNESS = 205000 * SIZE * SIZE
_GRASS_FRICTION = FRICTION_LIMIT * 0.6
_BRAKE_FORCE = 15
_LOCKING_BRAKE = 0.9
_SKID_POINTS = 30


def press_pedals(car: Car, steer: float, gas: float, brake: float) -> None:
    """
    Set the controls of the car as `Car.steer`, `Car.gas` and `Car.brake` do.

    Args:
        car: The car.
        steer: Wanted angle of the front wheels, positive to the left, radians.
        gas: Wanted gas of the rear wheels in [0, 1]; it rises by at most 0.1 per frame.
        brake: Brake of all wheels in [0, 1].
    """
    front_left, front_right, rear_left, rear_right = car.wheels
    front_left.steer = steer
    front_right.steer = steer
    for wheel in (rear_left, rear_right):
        rise = gas - wheel.gas
        wheel.gas += min(rise, 0.1)
    for wheel in (front_left, front_right, rear_left, rear_right):
        wheel.brake = brake


def push_wheels(car: Car, dt: float) -> None:
    """
    Turn the wheels of `car` and apply their forces for one frame of `dt` seconds.

    Args:
        car: The car, with the contact sets `wheel.tiles` up to date.
        dt: Length of the frame in seconds.
    """
    power = dt * ENGINE_POWER
    for w in car.wheels:
        joint = w.joint
        error = w.steer - joint.angle
        if error > 0.0:
            joint.motorSpeed = min(50.0 * error, 3.0)
        elif error < 0.0:
            joint.motorSpeed = -min(50.0 * -error, 3.0)
        else:
            joint.motorSpeed = 0.0

        friction_limit = _GRASS_FRICTION
        grass = True
        for tile in w.tiles:
            friction_limit = max(friction_limit, FRICTION_LIMIT * tile.road_friction)
            grass = False

        rotation = w.transform.q
        side_x = forward_y = rotation.c
        side_y = rotation.s
        forward_x = 0.0 - side_y
        velocity = w.linearVelocity
        velocity_x = velocity.x
        velocity_y = velocity.y
        vf = forward_x * velocity_x + forward_y * velocity_y
        vs = side_x * velocity_x + side_y * velocity_y

        omega = w.omega
        omega += power * w.gas / WHEEL_MOMENT_OF_INERTIA / (abs(omega) + 5.0)
        car.fuel_spent += power * w.gas

        brake = w.brake
        if brake >= _LOCKING_BRAKE:
            omega = 0.0
        elif brake > 0:
            drop = _BRAKE_FORCE * brake
            if drop > abs(omega):
                drop = abs(omega)
            if omega > 0.0:
                omega -= drop
            elif omega < 0.0:
                omega += drop
        w.phase += omega * dt

        radius = w.wheel_rad
        f_force = -vf + omega * radius
        p_force = -vs
        f_force *= _STIFFNESS
        p_force *= _STIFFNESS
        force = sqrt(f_force * f_force + p_force * p_force)

        if force > 2.0 * friction_limit:
            _leave_skid_mark(car, w, grass)
        else:
            w.skid_start = None
            w.skid_particle = None

        if force > friction_limit:
            f_force /= force
            p_force /= force
            f_force *= friction_limit
            p_force *= friction_limit

        w.omega = omega - dt * f_force * radius / WHEEL_MOMENT_OF_INERTIA
        w.ApplyForceToCenter(
            (
                p_force * side_x + f_force * forward_x,
                p_force * side_y + f_force * forward_y,
            ),
            True,
        )


def _leave_skid_mark(car: Car, wheel: object, grass: bool) -> None:
    """Add the wheel's position to the skid marks that `rgb_array` rendering shows."""
    mark = wheel.skid_particle
    if mark and mark.grass == grass and len(mark.poly) < _SKID_POINTS:
        mark.poly.append((wheel.position[0], wheel.position[1]))
    elif wheel.skid_start is None:
        wheel.skid_start = wheel.position
    else:
        wheel.skid_particle = car._create_particle(wheel.skid_start, wheel.position, grass)
        wheel.skid_start = None
