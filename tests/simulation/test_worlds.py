import mujoco
import numpy as np
import pytest

from openclone.errors import InputError
from openclone.robot import g1
from openclone.robot.model import build_model, standing_qpos
from openclone.simulation.robot import SimulatedRobot
from openclone.simulation.worlds import WORLD_NAMES, Person, World, build_world


@pytest.fixture(scope="module", params=WORLD_NAMES)
def world(request: pytest.FixtureRequest) -> World:
    return build_world(request.param)


def test_the_robot_itself_is_the_same_in_every_world(world: World) -> None:
    alone = build_model()
    assert (world.model.nq, world.model.nv, world.model.nu) == (36, 35, 29)
    for name in ("pelvis", "torso_link", "left_wrist_yaw_link"):
        ours, theirs = world.model.body(name), alone.body(name)
        np.testing.assert_array_equal(ours.mass, theirs.mass)
    assert world.model.nsensordata == alone.nsensordata


def test_the_robot_starts_in_free_space(world: World) -> None:
    """Standing at the origin it touches the floor and nothing else."""
    data = mujoco.MjData(world.model)
    data.qpos[:] = standing_qpos()
    mujoco.mj_forward(world.model, data)
    floor = world.model.geom("floor").id
    assert all(floor in contact.geom for contact in data.contact[: data.ncon])


def test_worlds_do_not_change_the_physics_far_from_walls() -> None:
    """Ten steps of the robot are the same in the hall as on the bare floor."""
    ends = []
    for name in ("flat", "hall"):
        robot = SimulatedRobot(build_world(name).model)
        for _ in range(10):
            robot.write(g1.DEFAULT_POSE)
            robot.advance()
        ends.append(robot.qpos)
    np.testing.assert_allclose(*ends, atol=1e-9)


def test_walls_and_furniture_stop_the_robot() -> None:
    """Thrown at the wall 4.5 m ahead, it does not get through."""
    robot = SimulatedRobot(build_world("room").model)
    qpos, qvel = standing_qpos(), np.zeros(35)
    qpos[0], qvel[0] = 4.0, 3.0
    robot.reset(qpos, qvel)
    furthest = 0.0
    for _ in range(50):
        robot.write(g1.DEFAULT_POSE)
        robot.advance()
        furthest = max(furthest, float(robot.qpos[0]))
    free = SimulatedRobot(build_world("flat").model)
    free.reset(qpos, qvel)
    for _ in range(50):
        free.write(g1.DEFAULT_POSE)
        free.advance()
    assert free.qpos[0] > 4.9
    assert furthest < 4.5


def test_people_walk_to_and_fro() -> None:
    person = Person((0.0, 0.0), (3.0, 4.0), speed=2.0)
    np.testing.assert_allclose(person.position(0.0), [0, 0, 0])
    np.testing.assert_allclose(person.position(1.25), [1.5, 2.0, 0])
    np.testing.assert_allclose(person.position(2.5), [3, 4, 0])
    np.testing.assert_allclose(person.position(3.75), [1.5, 2.0, 0])
    np.testing.assert_allclose(person.position(5.0), [0, 0, 0], atol=1e-12)
    world = build_world("people")
    data = mujoco.MjData(world.model)
    world.move_people(data, 1.0)
    mujoco.mj_forward(world.model, data)
    for index, someone in enumerate(world.people):
        place = data.body(f"person{index + 1}").xpos
        np.testing.assert_allclose(place, someone.position(1.0))


def test_an_unknown_world_is_refused() -> None:
    with pytest.raises(InputError, match="corridor"):
        build_world("moon")
