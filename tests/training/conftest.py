"""A small task on synthetic motion, shared by the training tests."""

import numpy as np
import pytest
import torch

from openclone.motion.clip import Clip, ClipInfo, clip_from_qpos
from openclone.robot import g1
from openclone.robot.model import SensorLayout, build_model, standing_qpos
from openclone.robot.state import RobotState
from openclone.training import student as student_module
from openclone.training.physics import ThreadedPhysics
from openclone.training.ppo import PpoConfig, build_ppo, collect, mlp_model
from openclone.training.presets import STUDENTS, TEACHERS
from openclone.training.progress import Budget, Progress
from openclone.training.reference import build_reference
from openclone.training.rewards import TrackingState
from openclone.training.storage import Rollouts
from openclone.training.student import train_student
from openclone.training.tally import Tally
from openclone.training.task import TaskConfig, TrackingTask
from openclone.training.teacher import train_teacher
from openclone.training.teacher_view import GROUP, TeacherEnvironment


def swaying(name: str = "sway", seconds: float = 3.0, category: str = "stand") -> Clip:
    """Standing with slowly waving arms; the legs rest."""
    count = round(seconds * 50) + 1
    qpos = np.tile(standing_qpos(), (count, 1))
    phase = np.sin(2 * np.pi * np.arange(count) / 50)
    qpos[:, 7 + g1.joint_index("left_shoulder_pitch_joint")] += 0.3 * phase
    qpos[:, 7 + g1.joint_index("right_elbow_joint")] += 0.3 * phase
    return clip_from_qpos(ClipInfo(name, category, "test", "", 50.0), qpos)


@pytest.fixture(scope="session")
def make_clip():
    return swaying


@pytest.fixture(scope="session")
def model():
    return build_model()


@pytest.fixture(scope="session")
def reference(model):
    return build_reference([swaying("a"), swaying("b", 2.0)], model, feedback=True)


@pytest.fixture
def make_task(model, reference):
    default = reference

    def make(num_envs: int = 4, reference=default, **settings: object) -> TrackingTask:
        physics = ThreadedPhysics(model, num_envs, threads=1)
        config = TaskConfig(num_envs=num_envs, **settings)
        return TrackingTask(reference, physics, SensorLayout.of(model), config, 0)

    return make


@pytest.fixture
def explore(tmp_path):
    """PPO's storage after one roll-out of an untrained teacher."""

    def explored(env: TeacherEnvironment, config: PpoConfig) -> Rollouts:
        torch.manual_seed(0)
        observations = env.observe()
        actor = mlp_model(observations, GROUP, g1.NUM_JOINTS, config)
        critic = mlp_model(observations, GROUP, 1, config)
        ppo = build_ppo(observations, actor, critic, config)
        progress = Progress(tmp_path, Budget(1.0))
        collect(env, ppo, config, progress, Tally(env.task), observations)
        progress.close()
        return ppo.storage

    return explored


@pytest.fixture(scope="session")
def trained(tmp_path_factory, make_clip):
    """Folder, teacher and student checkpoint of one run of the smoke presets."""
    out = tmp_path_factory.mktemp("run")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(student_module, "export_bundle", lambda *_: None)
        teacher = train_teacher([make_clip()], TEACHERS["smoke"], out, threads=1)
        train_student([make_clip()], teacher, STUDENTS["smoke"], out, threads=1)
    return out, teacher, out / "student.pt"


@pytest.fixture
def perfect(reference) -> TrackingState:
    """One robot that does exactly what its reference does."""
    frame = torch.tensor([10])
    robot = reference.at(frame)
    robot = RobotState(
        **{name: getattr(robot, name).clone() for name in robot.__dataclass_fields__}
    )
    zeros = torch.zeros(1, 29)
    return TrackingState(
        robot=robot,
        reference=reference.at(frame),
        action=zeros,
        previous_action=zeros,
        previous_velocities=robot.joint_velocities,
        terminated=torch.zeros(1, dtype=torch.bool),
        air_time=torch.zeros(1, 2),
        style=torch.zeros(1),
        period=0.02,
    )
