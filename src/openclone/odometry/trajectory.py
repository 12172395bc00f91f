"""Trajectories: TUM files, and how far two of them are apart."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from openclone.errors import InputError
from openclone.spatial import rotations

_MAX_TUM_BYTES = 500_000_000


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses of one body over time.

    Attributes:
        stamps_ns: (N,) int64, rising.
        positions: (N, 3), metres, in a world of its own.
        quats: (N, 4), wxyz, world from body.
    """

    stamps_ns: np.ndarray
    positions: np.ndarray
    quats: np.ndarray

    def __len__(self) -> int:
        """How many poses."""
        return len(self.stamps_ns)


@dataclass(frozen=True)
class TrajectoryError:
    """How far an estimate is from the truth after the best rigid alignment.

    Attributes:
        ate_rmse_m: root mean square of the position error (the usual ATE).
        ate_mean_m: its mean.
        ate_max_m: its largest value.
        heading_max_deg: largest rotation error about the vertical.
        poses: how many poses were compared.
    """

    ate_rmse_m: float
    ate_mean_m: float
    ate_max_m: float
    heading_max_deg: float
    poses: int


def write_tum(trajectory: Trajectory, path: Path) -> None:
    """Write ``stamp x y z qx qy qz qw`` per line: seconds, metres, and xyzw."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", encoding="ascii") as file:
        file.write("# timestamp_s x y z q_x q_y q_z q_w\n")
        for stamp_ns, position, quat in zip(
            trajectory.stamps_ns, trajectory.positions, trajectory.quats, strict=True
        ):
            # From integers, because a double holds today's time only to 0.2 µs.
            seconds, rest = divmod(int(stamp_ns), 1_000_000_000)
            numbers = " ".join(f"{v:.9f}" for v in (*position, *quat[[1, 2, 3, 0]]))
            file.write(f"{seconds}.{rest:09d} {numbers}\n")


def read_tum(path: Path) -> Trajectory:
    """Read a TUM file.

    Raises:
        InputError: missing, too large, or a line that is not eight finite numbers, a
            quaternion that is none, or stamps that do not rise.
    """
    if not path.is_file():
        raise InputError("no such file", where=str(path))
    if path.stat().st_size > _MAX_TUM_BYTES:
        raise InputError("larger than 500 MB", where=str(path))
    stamps: list[int] = []
    rows: list[list[float]] = []
    text = path.read_bytes().decode("utf-8", "replace")
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        where = f"{path}, line {number}"
        stamp_ns, row = _parse_line(line, where)
        if stamps and stamp_ns <= stamps[-1]:
            raise InputError("stamps do not rise", where=where)
        stamps.append(stamp_ns)
        rows.append(row)
    if not rows:
        raise InputError("a trajectory without poses", where=str(path))
    table = np.array(rows)
    quats = rotations.normalize(table[:, [6, 3, 4, 5]])
    return Trajectory(np.array(stamps), table[:, :3], np.asarray(quats))


def _parse_line(line: str, where: str) -> tuple[int, list[float]]:
    words = line.split()
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = []
    good = len(values) == 8 and bool(np.isfinite(values).all())
    if not good or not 0 <= values[0] < 9e9:
        raise InputError(
            f"{line.strip()[:60]!r} is no pose",
            where=where,
            remedy="eight numbers are needed: timestamp x y z qx qy qz qw",
        )
    if not 0.9 < float(np.linalg.norm(values[4:])) < 1.1:
        raise InputError("the quaternion is not a unit quaternion", where=where)
    whole, _, fraction = words[0].partition(".")
    if whole.isascii() and whole.isdigit() and (fraction.isdigit() or not fraction):
        return int(whole) * 1_000_000_000 + int(fraction[:9].ljust(9, "0")), values[1:]
    return round(values[0] * 1e9), values[1:]


def sample_at(trajectory: Trajectory, stamps_ns: np.ndarray) -> Trajectory:
    """Poses at other times, interpolated; times outside are left out."""
    known = trajectory.stamps_ns
    inside = (stamps_ns >= known[0]) & (stamps_ns <= known[-1])
    at = stamps_ns[inside]
    right = np.clip(np.searchsorted(known, at), 1, max(len(known) - 1, 1))
    if len(known) == 1:
        right = np.zeros(len(at), int)
    left = np.maximum(right - 1, 0)
    gap = np.maximum(known[right] - known[left], 1)
    share = ((at - known[left]) / gap)[:, None]
    start, end = trajectory.positions[left], trajectory.positions[right]
    quats = rotations.slerp(
        trajectory.quats[left], trajectory.quats[right], share[:, 0]
    )
    return Trajectory(at, start + share * (end - start), np.asarray(quats))


def rigid_alignment(
    source: np.ndarray, target: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3) and shift (3,) that bring ``source`` closest to ``target``.

    Umeyama, IEEE PAMI 13 (1991), without scale.
    """
    middle, goal = source.mean(axis=0), target.mean(axis=0)
    left, _, right = np.linalg.svd((target - goal).T @ (source - middle))
    mirror = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    turn = left @ mirror @ right
    return turn, goal - turn @ middle


def compare(estimate: Trajectory, truth: Trajectory) -> TrajectoryError:
    """Errors of ``estimate`` where ``truth`` covers it, after rigid alignment.

    Raises:
        InputError: fewer than three poses overlap.
    """
    if len(truth) == 0 or len(estimate) == 0:
        raise InputError("a trajectory without poses cannot be compared")
    real = sample_at(truth, estimate.stamps_ns)
    keep = np.isin(estimate.stamps_ns, real.stamps_ns)
    if len(real) < 3:
        raise InputError(
            f"only {len(real)} poses of the two trajectories overlap in time"
        )
    positions, quats = estimate.positions[keep], estimate.quats[keep]
    turn, shift = rigid_alignment(positions, real.positions)
    error = np.linalg.norm(positions @ turn.T + shift - real.positions, axis=1)
    relative = rotations.to_matrix(real.quats) @ np.swapaxes(
        rotations.to_matrix(quats), 1, 2
    )
    # What remains of the rotation once its mean, a free choice of worlds, is removed.
    left, _, right = np.linalg.svd(relative.mean(axis=0))
    rest = relative @ (left @ right).T
    heading = np.degrees(np.abs(np.arctan2(rest[:, 1, 0], rest[:, 0, 0])))
    return TrajectoryError(
        float(np.sqrt(np.mean(error**2))),
        float(error.mean()),
        float(error.max()),
        float(heading.max()),
        len(real),
    )
