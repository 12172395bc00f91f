"""When a recorded foot stands on the ground."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from openclone.motion.skeleton import SIDES, HumanMotion

_MAX_SLOPE = 0.15
"""Metres; a higher step is something that was climbed."""


@dataclass(frozen=True)
class ContactConfig:
    """Thresholds of contact detection.

    Attributes:
        max_speed: m/s, horizontal, of the ankle; a foot in flight is faster.
        speed_share: the same as a share of the foot's fastest swing nearby; the foot
            of a runner never rests.
        max_lift_speed: m/s, vertical, of the ankle; a lifting heel is faster.
        max_height: metres of the ball of the foot above its lowest level nearby.
        max_heel: metres of the ankle above its lowest level nearby.
        nearby_s: seconds before and after a frame that count as nearby: one stride.
            Many recordings were taken on a floor that is not level.
        max_drift: metres by which the floor may rise along a recording.
        min_stance_s: shorter stances and gaps are noise, seconds.
        ball_height: metres of the ball above its lowest level nearby while it bears.
        ball_share: speed of a bearing ball as a share of the foot's fastest swing.
    """

    max_speed: float = 0.35
    speed_share: float = 0.15
    max_lift_speed: float = 0.25
    max_height: float = 0.05
    max_heel: float = 0.12
    nearby_s: float = 0.7
    max_drift: float = 0.15
    min_stance_s: float = 0.08
    ball_height: float = 0.035
    ball_share: float = 0.25


def smooth(values: np.ndarray, sigma: float, *, going_on: bool = False) -> np.ndarray:
    """Gaussian filter over the first axis; ``sigma`` in frames.

    Args:
        values: (T, ...).
        sigma: width, frames.
        going_on: continue the ends at their speed; otherwise they are held, which
            brings a walk that begins in mid-stride almost to a stop.
    """
    if sigma < 0.1:
        return values
    reach = max(int(np.ceil(3 * sigma)), 1)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    kernel /= kernel.sum()
    flat = values.reshape(len(values), -1)
    around = ((reach, reach), (0, 0))
    if going_on:
        padded = np.pad(flat, around, mode="reflect", reflect_type="odd")
    else:
        padded = np.pad(flat, around, mode="edge")
    columns = [np.convolve(padded[:, k], kernel, "valid") for k in range(flat.shape[1])]
    return np.stack(columns, 1).reshape(values.shape)


def velocity(positions: np.ndarray, fps: float) -> np.ndarray:
    """Central differences over the first axis, metres per second."""
    return np.gradient(smooth(positions, 0.02 * fps, going_on=True), 1.0 / fps, axis=0)


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


def _above_nearby(
    height: np.ndarray, level: float, window: int, config: ContactConfig
) -> np.ndarray:
    """Metres (T,) of ``height`` above its lowest value nearby, which is near ``level``.

    Lowest values far above ``level`` belong to a foot that is held up.
    """
    lowest = minimum_filter1d(height, window, mode="nearest")
    return height - np.clip(lowest, level, level + config.max_drift)


def level_ground(motion: HumanMotion) -> HumanMotion:
    """Take out the slope of the floor: all stances of a foot come to one height.

    Recordings of a walk rise or sink by several centimetres along the room. Between
    stances the floor is interpolated.
    """
    contact = foot_contacts(motion)
    times, heights = [], []
    for index, side in enumerate(SIDES):
        track = motion.joint(f"{side}_ankle")[:, 2]
        stances = runs(contact[:, index])
        levels = np.array([np.median(track[start:stop]) for start, stop in stances])
        if len(levels):
            lengths = [stop - start for start, stop in stances]
            # Long stances weigh more in the foot's usual height.
            usual = float(np.median(np.repeat(levels, lengths)))
            times += [0.5 * (start + stop) for start, stop in stances]
            heights += list(levels - usual)
    if len(heights) < 2:
        return motion
    order = np.argsort(times)
    at = np.arange(motion.num_frames)
    floor = np.interp(at, np.array(times)[order], np.array(heights)[order])
    floor = np.clip(smooth(floor, 0.3 * motion.fps), -_MAX_SLOPE, _MAX_SLOPE)
    positions = motion.positions.copy()
    positions[..., 2] -= floor[:, None]
    return replace(motion, positions=positions)


def foot_contacts(
    motion: HumanMotion, config: ContactConfig | None = None
) -> np.ndarray:
    """(T, 2) booleans: the left and the right foot stand on the ground.

    Runners land and push off on the ball of a foot whose ankle moves. A low, slow ball
    counts where no foot stands otherwise: a walker's other foot bears by then.
    """
    config = config or ContactConfig()
    window = 2 * round(config.nearby_s * motion.fps) + 1
    frames = max(round(config.min_stance_s * motion.fps), 1)
    ankle_level = ground_level(motion, "ankle")
    toe_level = ground_level(motion, "toe")
    stands, balls = [], []
    for side in SIDES:
        ankle, toe = motion.joint(f"{side}_ankle"), motion.joint(f"{side}_toe")
        level_speed, lift_speed = _speeds(ankle, motion.fps)
        swing = maximum_filter1d(level_speed, window, mode="nearest")
        share = config.speed_share * swing
        toe_height = _above_nearby(toe[:, 2], toe_level, window, config)
        heel_height = _above_nearby(ankle[:, 2], ankle_level, window, config)
        low = (toe_height < config.max_height) & (heel_height < config.max_heel)
        slow = level_speed < np.maximum(config.max_speed, share)
        slow &= lift_speed < np.maximum(config.max_lift_speed, share)
        stands.append(_without_short_runs(low & slow, frames))
        ball_speed = np.max(_speeds(toe, motion.fps), axis=0)
        balls.append(
            low
            & (toe_height < config.ball_height)
            & (ball_speed < config.ball_share * swing)
        )
    contact = np.stack(stands, 1)
    contact |= np.stack(balls, 1) & ~contact.any(axis=1, keepdims=True)
    return np.stack([_without_short_runs(column, frames) for column in contact.T], 1)


def _speeds(track: np.ndarray, fps: float) -> tuple[np.ndarray, np.ndarray]:
    """Horizontal and vertical speed (T,) along ``track (T, 3)``, m/s."""
    speed = velocity(track, fps)
    return np.linalg.norm(speed[:, :2], axis=1), np.abs(speed[:, 2])
