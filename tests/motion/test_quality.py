"""Quality figures against fabricated faults whose size is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from openclone.motion.quality import ClipQuality, Gate, QualityMeter, faults
from openclone.motion.targets import Targets
from openclone.robot import g1
from openclone.robot.kinematics import Kinematics
from openclone.robot.model import standing_qpos
from openclone.spatial import rotations

FPS = 50.0
FRAMES = 101
TIME = np.arange(FRAMES) / FPS


@pytest.fixture(scope="module")
def meter() -> QualityMeter:
    return QualityMeter()


@pytest.fixture
def still() -> np.ndarray:
    """Two seconds of standing."""
    return np.tile(standing_qpos(), (FRAMES, 1))


def joint(name: str) -> int:
    return 7 + g1.joint_index(name)


def reasons(quality: ClipQuality) -> str:
    return "; ".join(faults(quality))


def test_standing_has_no_fault(meter: QualityMeter, still: np.ndarray) -> None:
    quality = meter.measure(still, FPS)
    assert faults(quality) == ()
    assert quality.seconds == pytest.approx(2.0)
    assert (quality.ankle_mm, quality.wrist_mm) == (None, None)
    assert quality.slide_cm_s == quality.peak_speed == quality.air_s == 0
    assert quality.tilt_deg == pytest.approx(0, abs=1e-6)
    assert quality.limit_joint == ""


def test_sliding_feet(meter: QualityMeter, still: np.ndarray) -> None:
    still[:, 1] += 0.2 * TIME
    quality = meter.measure(still, FPS)
    assert quality.slide_cm_s == pytest.approx(20, rel=1e-6)
    assert faults(quality) == ("the standing feet slide at 20.0 cm/s (at most 15)",)


def test_feet_in_the_air_do_not_slide(meter: QualityMeter, still: np.ndarray) -> None:
    still[:, 0] += 3.0 * TIME
    still[:, 2] += 0.05
    assert meter.measure(still, FPS).slide_cm_s == 0


def test_underground(meter: QualityMeter, still: np.ndarray) -> None:
    still[20:30, 2] -= 0.02
    quality = meter.measure(still, FPS)
    assert quality.ground_share == pytest.approx(10 / FRAMES)
    assert "under the ground in 9.9%" in reasons(quality)
    still[20:30, 2] += 0.012  # 8 mm are left
    assert meter.measure(still, FPS).ground_share == 0


def test_a_knee_underground_counts(meter: QualityMeter, still: np.ndarray) -> None:
    """Kneeling: the thighs upright, the shanks level, the pelvis 15 cm too low."""
    for side in ("left", "right"):
        still[:, joint(f"{side}_hip_pitch_joint")] = 0.0
        still[:, joint(f"{side}_knee_joint")] = np.pi / 2
        still[:, joint(f"{side}_ankle_pitch_joint")] = 0.5
    # Hips are 0.133 m below the pelvis, knees 0.306 m below the hips.
    still[:, 2] = 0.133 + 0.306 - 0.15
    assert meter.measure(still, FPS).ground_share == 1


def test_links_inside_each_other(meter: QualityMeter, still: np.ndarray) -> None:
    still[40:50, joint("left_shoulder_roll_joint")] = -1.0
    quality = meter.measure(still, FPS)
    assert quality.self_share == pytest.approx(10 / FRAMES)
    assert "inside each other" in reasons(quality)


def test_joint_faster_than_its_motor(meter: QualityMeter, still: np.ndarray) -> None:
    still[50:, joint("left_knee_joint")] += 0.5
    quality = meter.measure(still, FPS)
    assert quality.peak_speed == pytest.approx(25)
    assert quality.speed_ratio == pytest.approx(25 / 20)
    assert quality.peak_acceleration == pytest.approx(0.5 * 2500)
    assert "1.25 times its motor's speed" in reasons(quality)


def test_jerking_arms(meter: QualityMeter, still: np.ndarray) -> None:
    """An elbow that goes 0.2 rad up and back within 40 ms, ten times."""
    for start in range(5, 95, 9):
        still[start, joint("right_elbow_joint")] += 0.2
    quality = meter.measure(still, FPS)
    assert quality.peak_speed == pytest.approx(10)
    assert quality.spike_share >= 10 / FRAMES
    assert "jerk back and forth" in reasons(quality)


def test_a_fast_swing_is_no_spike(meter: QualityMeter, still: np.ndarray) -> None:
    """1 rad at 1.5 Hz peaks at 9.4 rad/s and 89 rad/s²."""
    swing = np.sin(2 * np.pi * 1.5 * TIME)
    still[:, joint("left_shoulder_pitch_joint")] += swing
    quality = meter.measure(still, FPS)
    assert quality.peak_speed == pytest.approx(3 * np.pi, rel=0.01)
    assert quality.spike_share == 0
    assert faults(quality) == ()


def test_floating(meter: QualityMeter, still: np.ndarray) -> None:
    still[30:61, 2] += 0.06
    quality = meter.measure(still, FPS)
    assert quality.float_s == quality.air_s == pytest.approx(31 / FPS)
    assert "floats for 0.62 s" in reasons(quality)


def test_a_jump_is_not_floating(meter: QualityMeter, still: np.ndarray) -> None:
    """Half a second of flight under gravity: 31 cm high."""
    flight = np.clip(TIME - 0.7, 0, 0.5)
    still[:, 2] += 0.5 * 9.81 * flight * (0.5 - flight)
    quality = meter.measure(still, FPS)
    assert quality.air_s == pytest.approx(0.5, abs=0.06)
    assert quality.float_s == 0
    assert faults(quality) == ()


def test_body_flips_over(meter: QualityMeter, still: np.ndarray) -> None:
    """One frame upside down, as where an Euler angle passes 180 degrees."""
    still[60, 3:7] = (0, 1, 0, 0)
    quality = meter.measure(still, FPS)
    assert quality.tilt_deg == pytest.approx(180)
    assert quality.turn_rad_s == pytest.approx(np.pi * FPS)
    assert "flips over: the pelvis leans by 180 deg" in reasons(quality)


def test_body_flips_round(meter: QualityMeter, still: np.ndarray) -> None:
    still[60:, 3:7] = rotations.from_yaw(np.array(1.0))
    quality = meter.measure(still, FPS)
    assert quality.turn_rad_s == pytest.approx(50)
    assert "flips round: the pelvis turns at 50.0 rad/s" in reasons(quality)


def test_off_its_targets(meter: QualityMeter, still: np.ndarray) -> None:
    bodies, _ = Kinematics().trajectory(still)
    index = {name: k for k, name in enumerate(g1.KEY_BODIES)}
    links = [f"{s}_{p}" for s in ("left", "right") for p in ("ankle_roll", "wrist_yaw")]
    position = {f"{k}_link": bodies[:, index[f"{k}_link"]].copy() for k in links}
    contact = np.ones((FRAMES, 2), dtype=bool)
    quality = meter.measure(still, FPS, Targets(position, {}, contact))
    assert quality.ankle_mm == pytest.approx(0, abs=1e-6)
    assert quality.lost_share == 0
    # One foot is 60 mm off all the time, one hand 300 mm: the means are half of it.
    position["left_ankle_roll_link"][:, 0] += 0.06
    position["right_wrist_yaw_link"][:, 2] -= 0.3
    quality = meter.measure(still, FPS, Targets(position, {}, contact))
    assert quality.ankle_mm == pytest.approx(30)
    assert quality.wrist_mm == pytest.approx(150)
    assert "feet are off their targets by 30 mm" in reasons(quality)
    assert quality.lost_share == 1
    assert "far from its target in 100.0% of the frames" in reasons(quality)
    assert "wrists are off their targets by 150 mm" in reasons(quality)


def test_joint_at_its_limit_is_told(meter: QualityMeter, still: np.ndarray) -> None:
    name = "waist_pitch_joint"
    still[:25, joint(name)] = g1.JOINT_UPPER[g1.joint_index(name)] - 0.005
    quality = meter.measure(still, FPS)
    assert quality.limit_share == pytest.approx(25 / FRAMES)
    assert quality.limit_joint == name


def test_too_short(meter: QualityMeter, still: np.ndarray) -> None:
    quality = meter.measure(still[:11], FPS)
    assert faults(quality) == ("only 0.20 s (at least 0.5)",)
    assert faults(quality, Gate(min_seconds=0.0)) == ()


def test_the_gate_is_told_apart(meter: QualityMeter, still: np.ndarray) -> None:
    quality = replace(meter.measure(still, FPS), slide_cm_s=4.0)
    assert faults(quality) == ()
    assert "slide" in "".join(faults(quality, Gate(slide_cm_s=3.0)))
