"""The five metrics of section 4.1, and drift, sway and steps. Pure NumPy.

A `Trace` holds what one closed-loop run did beside what it should have done; every
metric is a function of it. Key bodies are `g1.KEY_BODIES`; time runs along axis 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields

import numpy as np

from openclone.robot import g1
from openclone.robot.state import key_point_poses
from openclone.spatial import rotations

MAX_POINT_DISTANCE = 1.5
"""Metres; section 4.1: further away on average, and the episode is no success."""
CONTACT_FORCE = 1.0
"""N of vertical ground force below which a foot counts as lifted."""
LIFT_FRAMES = 2
"""A foot must be off the ground this long (40 ms at 50 Hz) for a step to count."""
TREMOR_FRAMES = 5
"""Velocities are compared with their mean over this long (0.1 s at 50 Hz); odd."""
_MM = 1000.0


@dataclass(frozen=True)
class Trace:
    """One closed-loop run against its reference, T frames, world frame.

    Attributes:
        period: seconds between frames.
        position, reference_position: (T, 14, 3), metres, key bodies.
        quat, reference_quat: (T, 14, 4), wxyz, world from body.
        contact: (T, 2) bool, whether the left and the right foot bear load; None where
            that was not measured.
        fell: whether the robot fell; the trace then ends with the fall.
    """

    period: float
    position: np.ndarray
    quat: np.ndarray
    reference_position: np.ndarray
    reference_quat: np.ndarray
    contact: np.ndarray | None
    fell: bool


@dataclass(frozen=True)
class Metrics:
    """Results of one run, or means over several runs.

    Attributes:
        sr: success rate, 0 to 1.
        mpkpe_mm, r_mpkpe_mm: mean key-body position error, global and root-relative.
        e_vel_mm_s: mean key-body velocity error.
        e_hand_x100: 100 x (1 - <q̂, q>²), mean over both hands.
        drift_mm: horizontal head error at the end.
        tremor_mm_s, reference_tremor_mm_s: `tremor` of the robot and of its reference.
        seconds: length of the runs together.
    """

    sr: float
    mpkpe_mm: float
    r_mpkpe_mm: float
    e_vel_mm_s: float
    e_hand_x100: float
    drift_mm: float
    tremor_mm_s: float
    reference_tremor_mm_s: float
    seconds: float

    def to_json(self) -> dict[str, float | None]:
        """The fields by name; ``sr`` in percent, as in Table 1; NaN becomes null."""
        values = {**asdict(self), "sr": 100.0 * self.sr}
        return {k: float(v) if np.isfinite(v) else None for k, v in values.items()}


def position_error(position: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Distance of each key body from its reference, ``(T, n, 3) -> (T, n)``, metres."""
    return np.linalg.norm(position - reference, axis=-1)


def root_relative(position: np.ndarray, quat: np.ndarray) -> np.ndarray:
    """Key bodies as seen from their own root, ``(T, 14, 3)``, metres.

    Root-relative means: minus the pelvis position, in the pelvis' heading frame. The
    yaw is taken out as well as the position, so that a robot in the right pose that
    stands elsewhere, turned, has no error; its roll and pitch still count.
    """
    offset = position - position[:, g1.ROOT, None]
    turn = rotations.heading(quat[:, g1.ROOT])[:, None] * np.ones(
        (1, len(offset[0]), 1)
    )
    return rotations.rotate_inverse(turn, offset)


def velocity_error(
    position: np.ndarray, reference: np.ndarray, period: float
) -> np.ndarray:
    """Norm of the key bodies' velocity error, ``(T - 1, 14)``, m/s.

    Both velocities are differences of consecutive frames: the same filter on both.
    """
    return np.linalg.norm(np.diff(position - reference, axis=0), axis=-1) / period


def tremor(position: np.ndarray, period: float) -> float:
    """Mean speed of key bodies about its own moving average, m/s; NaN if too short.

    Steps take a quarter of a second and more, and hardly count. A robot that trembles,
    or walks by trembling, shows here and not in its position errors.

    Args:
        position: (T, 14, 3), metres.
        period: seconds between frames.
    """
    velocity = np.diff(position, axis=0) / period
    if len(velocity) < TREMOR_FRAMES:
        return float("nan")
    half = TREMOR_FRAMES // 2
    around = np.lib.stride_tricks.sliding_window_view(velocity, TREMOR_FRAMES, axis=0)
    rest = velocity[half : len(velocity) - half] - around.mean(axis=-1)
    return float(np.linalg.norm(rest, axis=-1).mean())


def hand_error(quat: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """``1 - <q̂, q>²`` of the hands, ``(T, 14, 4) -> (T, 2)``, in [0, 1].

    A hand point is fixed in its wrist, so their orientation errors are the same.
    """
    hands = list(g1.WRISTS)
    dots = np.sum(quat[:, hands] * reference[:, hands], axis=-1)
    return 1.0 - np.minimum(dots**2, 1.0)


def point_distance(trace: Trace) -> np.ndarray:
    """Mean distance of head and hands from their reference, ``(T,)``, metres."""
    points, _ = key_point_poses(trace.position, trace.quat)
    wanted, _ = key_point_poses(trace.reference_position, trace.reference_quat)
    return position_error(points, wanted).mean(axis=1)


def succeeded(trace: Trace) -> bool:
    """No fall, and head and hands on average within 1.5 m throughout (section 4.1)."""
    return not trace.fell and bool(np.all(point_distance(trace) < MAX_POINT_DISTANCE))


def head_drift(trace: Trace) -> np.ndarray:
    """Horizontal distance of the head from its reference, ``(T,)``, metres."""
    points, _ = key_point_poses(trace.position, trace.quat)
    wanted, _ = key_point_poses(trace.reference_position, trace.reference_quat)
    return np.linalg.norm((points - wanted)[:, 0, :2], axis=-1)


def measure(trace: Trace) -> Metrics:
    """All metrics of one run."""
    robot, wanted = trace.position, trace.reference_position
    own = root_relative(robot, trace.quat)
    own_wanted = root_relative(wanted, trace.reference_quat)
    speed = velocity_error(robot, wanted, trace.period)
    return Metrics(
        sr=float(succeeded(trace)),
        mpkpe_mm=_MM * float(position_error(robot, wanted).mean()),
        r_mpkpe_mm=_MM * float(position_error(own, own_wanted).mean()),
        e_vel_mm_s=_MM * float(speed.mean()) if len(speed) else float("nan"),
        e_hand_x100=100.0 * float(hand_error(trace.quat, trace.reference_quat).mean()),
        drift_mm=_MM * float(head_drift(trace)[-1]),
        tremor_mm_s=_MM * tremor(robot, trace.period),
        reference_tremor_mm_s=_MM * tremor(wanted, trace.period),
        seconds=len(robot) * trace.period,
    )


def average(results: Sequence[Metrics]) -> Metrics:
    """Mean over runs; ``seconds`` is their sum.

    Every run counts once, whatever its length: a run that ends early in a fall would
    otherwise weigh less than one that goes well.
    """

    def mean(name: str) -> float:
        values = np.array([getattr(result, name) for result in results])
        values = values[np.isfinite(values)]
        return float(values.mean()) if len(values) else float("nan")

    means = {field.name: mean(field.name) for field in fields(Metrics)}
    means["seconds"] = float(sum(result.seconds for result in results))
    return Metrics(**means)


def sway(points_w: np.ndarray) -> float:
    """Largest horizontal distance of a point from its mean place, millimetres.

    Args:
        points_w: (T, n, 3), metres, e.g. head and pelvis.
    """
    horizontal = points_w[..., :2]
    excursion = np.linalg.norm(horizontal - horizontal.mean(axis=0), axis=-1)
    return _MM * float(excursion.max())


def count_steps(contact: np.ndarray, lift_frames: int = LIFT_FRAMES) -> int:
    """Times a foot left the ground for at least ``lift_frames`` frames.

    Args:
        contact: (T, 2) bool, left and right foot.
        lift_frames: shorter breaks are chatter of the contact, not steps.
    """
    steps = 0
    for foot in contact.T:
        lifted = np.concatenate(([False], ~foot, [False]))
        edges = np.flatnonzero(lifted[1:] != lifted[:-1])
        lengths = edges[1::2] - edges[::2]
        steps += int(np.sum(lengths >= lift_frames))
    return steps
