"""When a recorded foot stands on the ground."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from openclone.motion.skeleton import SIDES, HumanMotion


@dataclass(frozen=True)
class ContactConfig:
    """Thresholds of contact detection.

    Attributes:
        max_speed: m/s, horizontal, of the ankle; a foot in flight is faster.
        max_lift_speed: m/s, vertical, of the ankle; a lifting heel is faster.
        max_height: metres of the ball of the foot above its lowest level.
        max_heel: metres of the ankle above its lowest level.
        min_stance_s: shorter stances and gaps are noise, seconds.
    """

    max_speed: float = 0.35
    max_lift_speed: float = 0.25
    max_height: float = 0.05
    max_heel: float = 0.12
    min_stance_s: float = 0.08


def smooth(values: np.ndarray, sigma: float) -> np.ndarray:
    """Gaussian filter over the first axis; ``sigma`` in frames, ends held."""
    if sigma < 0.1:
        return values
    reach = max(int(np.ceil(3 * sigma)), 1)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    kernel /= kernel.sum()
    flat = values.reshape(len(values), -1)
    padded = np.pad(flat, ((reach, reach), (0, 0)), mode="edge")
    columns = [np.convolve(padded[:, k], kernel, "valid") for k in range(flat.shape[1])]
    return np.stack(columns, 1).reshape(values.shape)


def velocity(positions: np.ndarray, fps: float) -> np.ndarray:
    """Central differences over the first axis, metres per second."""
    return np.gradient(smooth(positions, 0.02 * fps), 1.0 / fps, axis=0)


def ground_level(motion: HumanMotion, joint: str) -> float:
    """Metres; height of ``joint`` (e.g. ``"ankle"``) when its foot stands.

    The lower of both feet's low percentiles: the ground is the same for both, and a
    clip may never put one foot down. Frames in which the joint moves do not count,
    so that a jump's pointed toes do not lower the ground.
    """
    levels = []
    for side in SIDES:
        track = motion.joint(f"{side}_{joint}")
        speed = np.linalg.norm(velocity(track, motion.fps), axis=1)
        calm = track[speed <= max(0.3, float(np.percentile(speed, 20))), 2]
        levels.append(float(np.percentile(calm, 10)))
    return min(levels)


def _without_short_runs(mask: np.ndarray, frames: int) -> np.ndarray:
    """Flip runs shorter than ``frames``: first the gaps, then the stances."""
    out = mask.copy()
    for value in (False, True):
        for start, stop in runs(out == value):
            inner = value or (start > 0 and stop < len(out))
            if stop - start < frames and inner:
                out[start:stop] = not value
    return out


def runs(mask: np.ndarray) -> list[tuple[int, int]]:
    """Half-open ``(start, stop)`` spans in which ``mask (T,)`` is true."""
    edges = np.diff(np.concatenate(([0], mask.astype(int), [0])))
    starts, stops = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    return list(zip(starts.tolist(), stops.tolist(), strict=True))


def foot_contacts(
    motion: HumanMotion, config: ContactConfig | None = None
) -> np.ndarray:
    """(T, 2) booleans: the left and the right foot stand on the ground."""
    config = config or ContactConfig()
    ankle_level = ground_level(motion, "ankle")
    toe_level = ground_level(motion, "toe")
    columns = []
    for side in SIDES:
        ankle, toe = motion.joint(f"{side}_ankle"), motion.joint(f"{side}_toe")
        speed = velocity(ankle, motion.fps)
        contact = (
            (np.linalg.norm(speed[:, :2], axis=1) < config.max_speed)
            & (np.abs(speed[:, 2]) < config.max_lift_speed)
            & (toe[:, 2] < toe_level + config.max_height)
            & (ankle[:, 2] < ankle_level + config.max_heel)
        )
        frames = max(round(config.min_stance_s * motion.fps), 1)
        columns.append(_without_short_runs(contact, frames))
    return np.stack(columns, 1)
