import mujoco
import numpy as np
import pytest

from openclone.robot import g1
from openclone.robot.model import standing_qpos
from openclone.training import regulator
from openclone.training.regulator import (
    DEVIATION_SIZE,
    Motion,
    regulate,
    regulate_all,
)


@pytest.fixture(scope="module")
def waving() -> Motion:
    """Standing with a rising arm, half a second."""
    qpos = np.tile(standing_qpos(), (25, 1))
    shoulder = g1.joint_index("left_shoulder_pitch_joint")
    qpos[:, 7 + shoulder] -= np.linspace(0.0, 1.0, 25)
    qvel = np.zeros((25, 35))
    qvel[:, 6 + shoulder] = -1.0 / (24 * 0.02)
    return Motion(qpos, qvel, np.roll(qpos, -1, 0)[:, 7:])


def simulated(model, motion, frame, away, added):
    """Deviation one control period after a robot begins beside a frame."""
    data = mujoco.MjData(model)
    data.qpos[:] = motion.sunk().qpos[frame]
    mujoco.mj_integratePos(model, data.qpos, away[:35], 1.0)
    data.qvel[:] = motion.qvel[frame] + away[35:]
    data.ctrl[:] = motion.targets[frame] + added
    mujoco.mj_step(model, data, 4)
    difference = np.empty(DEVIATION_SIZE)
    mujoco.mj_differentiatePos(
        model, difference[:35], 1.0, motion.qpos[frame + 1], data.qpos
    )
    difference[35:] = data.qvel - motion.qvel[frame + 1]
    return difference


def test_the_linear_system_predicts_the_simulation(model, waving):
    data = mujoco.MjData(model)
    a, b, defect = regulator._linearized(model, data, waving, waving.sunk())
    rng = np.random.default_rng(0)
    sunk = np.zeros(DEVIATION_SIZE)
    sunk[2] = -0.003
    for _ in range(5):
        away = np.zeros(DEVIATION_SIZE)
        away[35 + 6 :] = 0.3 * rng.standard_normal(29)  # joint velocities
        added = 0.05 * rng.standard_normal(29)
        wanted = simulated(model, waving, 10, away, added)
        nothing = simulated(model, waving, 10, np.zeros(70), np.zeros(29))
        got = a[10] @ (away + sunk) + b[10] @ added + defect[10]
        change = np.abs(wanted - nothing)[41:].max()
        assert np.abs(got - wanted)[41:].max() < 0.35 * change


def test_the_recursion_solves_the_riccati_equation():
    """Against scipy, for a double integrator held for ever."""
    from scipy.linalg import solve_discrete_are

    a, b = np.eye(DEVIATION_SIZE), np.zeros((DEVIATION_SIZE, 29))
    a[6:35, 41:] = 0.02 * np.eye(29)
    a[:6], a[35:41] = 0.5 * a[:6], 0.5 * a[35:41]
    b[41:] = 2.0 * np.eye(29)
    gains = regulator._riccati(
        np.tile(a, (60, 1, 1)), np.tile(b, (60, 1, 1)), np.zeros((60, DEVIATION_SIZE))
    )[0].astype(float)
    value = solve_discrete_are(a, b, regulator._COST, regulator._EFFORT)
    wanted = -np.linalg.solve(regulator._EFFORT + b.T @ value @ b, b.T @ value @ a)
    np.testing.assert_allclose(gains[:, :-1], wanted, atol=2e-3 * np.abs(wanted).max())
    np.testing.assert_array_equal(gains[:, -1], 0.0)


def test_gains_are_kept_and_damaged_files_made_anew(model, waving, tmp_path):
    short = Motion(waving.qpos[:5], waving.qvel[:5], waving.targets[:5])
    (first,) = regulate_all(model, [short], tmp_path)
    (file,) = tmp_path.iterdir()
    np.testing.assert_array_equal(np.load(file), first)
    np.testing.assert_array_equal(regulate(model, short), first)
    np.save(file, np.full_like(first, 2.0))
    (kept,) = regulate_all(model, [short], tmp_path)
    assert (kept == 2.0).all()
    for damage in (b"", b"\x93NUMPY", file.read_bytes()[:-5]):
        file.write_bytes(damage)
        (again,) = regulate_all(model, [short], tmp_path)
        np.testing.assert_array_equal(again, first)
    np.save(file, np.full_like(first, np.nan))
    (again,) = regulate_all(model, [short], tmp_path)
    np.testing.assert_array_equal(again, first)


def test_a_motion_that_stands_still_is_linearized_once(model, monkeypatch):
    qpos, still = np.tile(standing_qpos(), (30, 1)), np.zeros((30, 35))
    calls = []
    one = regulator._transition
    monkeypatch.setattr(
        regulator, "_transition", lambda *rest: calls.append(1) or one(*rest)
    )
    motion = Motion(qpos, still, qpos[:, 7:])
    regulator._linearized(model, mujoco.MjData(model), motion, motion.sunk())
    assert len(calls) == 1


def test_where_contacts_begin_the_nearest_sound_system_counts():
    a = np.tile(np.eye(DEVIATION_SIZE), (6, 1, 1))
    a[2, 0, 0] = a[3, 5, 5] = 1e6
    assert regulator._nearest_sound(a).tolist() == [0, 1, 1, 4, 4, 5]
    a[:] = 1e6
    assert regulator._nearest_sound(a).tolist() == [0, 1, 2, 3, 4, 5]
