"""From clips to a ready tracking task."""

from __future__ import annotations

import math

import numpy as np

from openclone.errors import InputError
from openclone.motion.clip import Clip
from openclone.motion.edit import mirror, pad_still
from openclone.robot.model import SensorLayout
from openclone.training.hardware import Hardware
from openclone.training.reference import ReferenceMotions, build_reference
from openclone.training.task import TaskConfig, TrackingTask
from openclone.training.terrain import build_terrain, build_training_model

_MIN_SECONDS = 0.6


def is_recorded(clip: Clip) -> bool:
    """Whether a clip is a recording as it was: neither synthesized nor edited."""
    return clip.info.recorded and "~" not in clip.info.name


def top_speed(clip: Clip) -> float:
    """Metres per second over the ground, on average over the fastest half second."""
    step = np.diff(clip.root_position[:, :2], axis=0)
    speed = np.linalg.norm(step, axis=1) * clip.info.fps
    window = min(len(speed), max(1, round(0.5 * clip.info.fps)))
    return float(np.convolve(speed, np.full(window, 1.0 / window), "valid").max())


def select_clips(
    clips: list[Clip],
    categories: tuple[str, ...] | None,
    mirrored: bool,
    still_seconds: float,
    fastest: float = math.inf,
) -> list[Clip]:
    """Training motions: of the wanted categories and speeds, padded and mirrored.

    Raises:
        InputError: no clip is left.
    """
    chosen = [
        pad_still(clip, still_seconds)
        for clip in clips
        if (categories is None or clip.info.category in categories)
        and clip.seconds >= _MIN_SECONDS
        and top_speed(clip) <= fastest
    ]
    if not chosen:
        raise InputError(
            "no clip of the wanted categories and speeds",
            remedy="check --motions, or use a preset with other categories",
        )
    if mirrored:
        chosen += [mirror(clip) for clip in chosen]
    return chosen


def load_reference(
    clips: list[Clip],
    hardware: Hardware | None = None,
    feedback: bool = False,
    ground: bool = True,
) -> ReferenceMotions:
    """Tables of the reference for ``clips``, on the run's device.

    Args:
        clips: the motions.
        hardware: device, and the model's file; the CPU by default.
        feedback: with feedback gains, which tasks of that kind need.
        ground: with what the guidance "feedforward" needs; without, it takes less time.
    """
    hardware = hardware or Hardware()
    model = build_training_model(file=hardware.model)
    return build_reference(clips, model, feedback, ground).to(hardware.torch_device())


def make_task(
    reference: ReferenceMotions,
    config: TaskConfig,
    seed: int,
    threads: int | None,
    hardware: Hardware | None = None,
) -> TrackingTask:
    """A tracking task on the chosen hardware.

    Args:
        reference: what to track.
        config: settings of the task.
        seed: of all randomness, the terrain's shape included.
        threads: that step the robots; by default the process's share of the cores.
        hardware: back-end and device; the cores of this machine by default.

    Raises:
        ValueError: the guidance needs a reference that knows of the ground.
    """
    if config.guidance == "feedforward" and not reference.grounded:
        raise ValueError("the guidance needs a reference with `ground`")
    hardware = hardware or Hardware()
    rng = np.random.default_rng([seed, 4])
    terrain = build_terrain(config.randomization.terrain, rng)
    model = build_training_model(terrain, file=hardware.model)
    physics = hardware.make_physics(model, config.num_envs, threads)
    layout = SensorLayout.of(model)
    return TrackingTask(reference, physics, layout, config, seed, terrain)
