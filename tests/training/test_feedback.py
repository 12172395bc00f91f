import mujoco
import numpy as np
import pytest
import torch

from openclone.motion.clip import clip_from_qpos
from openclone.motion.edit import mirror
from openclone.motion.sources.synthetic import generate
from openclone.robot import g1
from openclone.robot.model import SensorLayout, standing_qpos
from openclone.robot.state import read_state
from openclone.training.feedback import corrections, deviation, mirrored_feedback
from openclone.training.reference import build_reference
from openclone.training.regulator import DEVIATION_SIZE, Motion, regulate
from openclone.training.task import TrackingTask


@pytest.fixture(autouse=True)
def own_cache(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))


@pytest.fixture(scope="module")
def walk():
    clip = generate("forward", np.random.default_rng(0))
    return clip_from_qpos(clip.info, clip.resampled(50.0).qpos[:200])


def measured(model: mujoco.MjModel, qpos: np.ndarray, qvel: np.ndarray):
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = qpos, qvel
    mujoco.mj_forward(model, data)
    parts = (data.qpos, data.qvel, data.sensordata)
    tensors = (torch.tensor(part, dtype=torch.float32)[None] for part in parts)
    return read_state(SensorLayout.of(model), *tensors)


def test_deviations_are_those_of_mujocos_tangent_space(model):
    rng = np.random.default_rng(1)
    states = []
    for _ in range(2):
        qpos, qvel = standing_qpos(), 0.5 * rng.standard_normal(35)
        mujoco.mj_integratePos(model, qpos, 0.2 * rng.standard_normal(35), 1.0)
        states.append((qpos, qvel))
    wanted = np.empty(DEVIATION_SIZE)
    mujoco.mj_differentiatePos(model, wanted[:35], 1.0, states[1][0], states[0][0])
    wanted[35:] = states[0][1] - states[1][1]
    got = deviation(*(measured(model, *state) for state in states))
    np.testing.assert_allclose(got[0].numpy(), wanted, atol=1e-5)


def test_a_pushed_robot_comes_back(model):
    """Standing, kicked to 0.25 m/s forward: without feedback it falls."""
    qpos, still = np.tile(standing_qpos(), (2, 1)), np.zeros((2, 35))
    gains = torch.tensor(regulate(model, Motion(qpos, still, qpos[:, 7:]))[:1])
    data = mujoco.MjData(model)

    def height_after(seconds: float, strength: float) -> float:
        mujoco.mj_resetData(model, data)
        data.qpos[:] = qpos[0]
        data.qvel[0] = 0.25
        for _ in range(round(50 * seconds)):
            robot = measured(model, data.qpos, data.qvel)
            away = deviation(robot, measured(model, qpos[0], still[0]))
            added = corrections(gains, away)[0].numpy()
            data.ctrl[:] = qpos[0, 7:] + strength * added
            mujoco.mj_step(model, data, 4)
        return float(data.qpos[2])

    standing = standing_qpos()[2]
    assert height_after(3.0, 0.0) < 0.5 * standing
    assert height_after(3.0, 1.0) > 0.95 * standing


def falls(task: TrackingTask, steps: int, feedback: bool) -> int:
    nothing, count = torch.zeros(task.num_envs, g1.NUM_JOINTS), 0
    for _ in range(steps):
        action = task.feedback_action() if feedback else nothing
        count += int(task.step(task.residual_to_target(action)).terminated.sum())
    return count


def test_a_walk_needs_no_training_for_a_while(model, walk, make_task):
    """Robots that begin anywhere in a walk, for two seconds, without any policy."""
    reference = build_reference([walk], model, feedback=True)
    calm = {"displaced_share": 0.0, "push_speed": 0.0, "failure_share": 0.0}
    without, guided = (
        falls(make_task(16, reference=reference, **calm), 100, feedback)
        for feedback in (False, True)
    )
    assert without >= 12
    assert guided <= 0.25 * without


def test_gains_of_a_mirrored_motion_are_mirrored(model, walk):
    """The robot's own inertias are only nearly symmetric."""
    short = clip_from_qpos(walk.info, walk.qpos[:60])
    both = build_reference([short, mirror(short)], model, feedback=True)
    assert both.feedback is not None
    given = both.feedback[both.clip == 1].numpy()
    alone = build_reference([mirror(short)], model, feedback=True).feedback
    assert alone is not None
    gap = np.abs(given.astype(float) - alone.numpy())
    assert np.median(gap) < 0.05 * np.abs(given.astype(float)).mean()
    twice = mirrored_feedback(mirrored_feedback(given))
    np.testing.assert_array_equal(twice, given)


def test_corrections_are_bounded():
    gains = torch.full((1, 29, DEVIATION_SIZE + 1), 5.0, dtype=torch.float16)
    got = corrections(gains, torch.full((1, DEVIATION_SIZE), 9.0))
    torch.testing.assert_close(got, torch.full((1, 29), 0.5))
    none = corrections(torch.zeros_like(gains), torch.zeros(1, DEVIATION_SIZE))
    torch.testing.assert_close(none, torch.zeros(1, 29))
