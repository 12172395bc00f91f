"""The tracking task: follow the reference motions, many robots at a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import torch

from openclone.policy.teacher import teacher_observation
from openclone.robot import g1
from openclone.robot.model import CONTROL_PERIOD, SensorLayout
from openclone.robot.state import RobotState, read_state
from openclone.spatial import rotations
from openclone.training.births import displace, to_standing
from openclone.training.physics import Physics
from openclone.training.randomization import ActionPath, RobotFactory
from openclone.training.reference import ReferenceMotions
from openclone.training.reward_table import total_reward
from openclone.training.rewards import TrackingState
from openclone.training.task_config import TaskConfig
from openclone.training.task_config import TerminationLimits as TerminationLimits
from openclone.training.terrain import Terrain

_BIN = 25


@dataclass(frozen=True)
class StepResult:
    """What one control step brought, n robots.

    Attributes:
        reward: (n,).
        terminated: (n,) bool, failed.
        timed_out: (n,) bool, episode or clip over without failure.
        terms: mean of each reward term, per second.
        error: metres, mean key-body error in the world.
        outcomes: for each motion category, one bool per episode that ended in this
            step: whether it came to its end without failure.
    """

    reward: torch.Tensor
    terminated: torch.Tensor
    timed_out: torch.Tensor
    terms: dict[str, float]
    error: float
    outcomes: dict[str, list[bool]] = field(default_factory=dict)

    @property
    def done(self) -> torch.Tensor:
        """(n,) bool: episodes that ended and were reset."""
        return self.terminated | self.timed_out


Style = Callable[[RobotState, RobotState], torch.Tensor]
"""AMP: from the states before and after a step to its reward -log(1 - D), (n,)."""


class TrackingTask:
    """Robots, their place in the reference, and what follows from a joint target.

    ``targets`` are absolute joint angles; the teacher's residual actions and the
    student's actions are both turned into targets by the trainer.
    """

    def __init__(
        self,
        reference: ReferenceMotions,
        physics: Physics,
        layout: SensorLayout,
        config: TaskConfig,
        seed: int,
        terrain: Terrain | None = None,
    ) -> None:
        """Reset every robot to a random frame of ``reference``.

        Args:
            reference: on the device of ``physics``.
            physics: robots in the world that ``terrain`` describes.
            layout: where their sensors lie.
            config: see there.
            seed: of all randomness.
            terrain: uneven ground; None if all is flat.
        """
        self.reference = reference
        self.physics = physics
        self.config = config
        self.num_envs = physics.num_envs
        self.action_scale = torch.tensor(g1.ACTION_SCALE, dtype=torch.float32)
        self._layout = layout
        self._rng = np.random.default_rng(seed)
        self._torch_rng = torch.Generator().manual_seed(seed)
        # Streams of its own, so that a range of zero leaves all other draws alone.
        stream = np.random.default_rng([seed, 2])
        self._terrain, self._terrain_rng = terrain, np.random.default_rng([seed, 3])
        self._origin = np.zeros((physics.num_envs, 3))
        delays = torch.Generator(physics.device).manual_seed(seed + 1)
        self._path = ActionPath(config.randomization, physics.num_envs, delays)
        self._factory = RobotFactory(config.randomization, physics, self._path, stream)
        n = self.num_envs
        self.frame = torch.zeros(n, dtype=torch.long)
        self.age = torch.randint(
            0, config.episode_steps, (n,), generator=self._torch_rng
        )
        self.action = torch.zeros(n, g1.NUM_JOINTS)
        self.style: Style | None = None
        self._air_time = torch.zeros(n, 2)
        bins = reference.num_frames // _BIN + 1
        self.failures = torch.full((bins,), 0.1)
        self._visits = torch.ones(bins)
        self._looked_up: tuple[torch.Tensor, RobotState] | None = None
        self._displaced = torch.zeros(n, dtype=torch.bool)
        self._born_age = torch.zeros(n, dtype=torch.long)
        ages = self.age.clone()
        self._reset(torch.arange(n))
        # Spread the episodes' ends, so that resets do not come all at once.
        self.age[:] = self._born_age[:] = ages

    # What the policies see -----------------------------------------------------------

    def robot_state(self) -> RobotState:
        """Current states of the robots, float32."""
        return self._state

    def next_frame(self) -> torch.Tensor:
        """(n,) index of the reference frame for the next step, t + 1."""
        return torch.minimum(self.frame + 1, self.reference.last[self.frame])

    def next_reference(self) -> RobotState:
        """Reference states at t + 1."""
        return self._reference_at(self.next_frame())

    def _reference_at(self, frame: torch.Tensor) -> RobotState:
        """Reference states; observing and stepping ask for the same ones."""
        if self._looked_up is None or not torch.equal(self._looked_up[0], frame):
            # A copy: resets change the frames in place.
            self._looked_up = (frame.clone(), self.reference.at(frame))
        return self._looked_up[1]

    def residual_to_target(self, action: torch.Tensor) -> torch.Tensor:
        """Joint targets of the teacher's action: an offset to the reference angles."""
        angles = self.reference.frames.joint_angles[self.next_frame()]
        return angles + self.action_scale * action

    def teacher_observation(self) -> torch.Tensor:
        """(n, d): the privileged observation of section 3.1."""
        following = self.next_frame()
        reference = self._reference_at(following)
        bodies = self.reference.frames.body_position
        last = self.reference.last[following]
        ahead = torch.minimum(following + self.config.lead_frames, last)
        lead = bodies[ahead, g1.TORSO] - bodies[following, g1.TORSO]
        lead[:, 2] = 0.0
        shifted = replace(
            reference, body_position=reference.body_position + lead[:, None]
        )
        return teacher_observation(self._state, shifted, self.action)

    # Stepping ------------------------------------------------------------------------

    def step(self, targets: torch.Tensor) -> StepResult:
        """Advance one control period towards ``targets (n, 29)``, then reset the dead.

        Returns:
            Rewards and flags of the step; observations afterwards belong to the new
            episodes where ``done`` is set.
        """
        following = self.next_frame()
        reference = self._reference_at(following)
        previous_action = self.action
        self.action = (targets - reference.joint_angles) / self.action_scale
        before = self._state
        self._push()
        self.physics.step(self._path(targets))
        self.frame = following
        self.age += 1
        self._read()
        tracking = TrackingState(
            robot=self._state,
            reference=reference,
            action=self.action,
            previous_action=previous_action,
            previous_velocities=before.joint_velocities,
            terminated=torch.zeros(self.num_envs, dtype=torch.bool),
            air_time=self._air_time,
            style=self._style_reward(before),
            period=CONTROL_PERIOD,
        )
        failed = self._failed(tracking)
        tracking.terminated[:] = failed
        weights = self.config.weights
        per_second, terms = total_reward(tracking, weights)
        bounded = torch.nan_to_num(per_second).clamp(-weights.limit, weights.limit)
        reward = bounded * CONTROL_PERIOD
        terminated = failed | ~torch.isfinite(per_second)
        airborne = self._state.foot_force.norm(dim=-1) < 1.0
        self._air_time = (self._air_time + CONTROL_PERIOD) * airborne
        over = (self.age >= self.config.episode_steps) | (
            self.frame >= self.reference.last[self.frame]
        )
        timed_out = over & ~terminated
        self._count_failures(terminated)
        error = (self._state.body_position - reference.body_position).norm(dim=-1)
        ids = torch.nonzero(terminated | timed_out).squeeze(-1)
        outcomes = self._outcomes(ids, terminated)
        if len(ids):
            self._reset(ids)
        return StepResult(
            reward=reward,
            terminated=terminated,
            timed_out=timed_out,
            terms={name: float(value.mean()) for name, value in terms.items()},
            error=float(error.mean()),
            outcomes=outcomes,
        )

    def _style_reward(self, before: RobotState) -> torch.Tensor:
        if self.style is None:
            return torch.zeros(self.num_envs)
        return self.style(before, self._state)

    def _outcomes(
        self, ids: torch.Tensor, terminated: torch.Tensor
    ) -> dict[str, list[bool]]:
        """Which of the episodes ``ids`` ended well, by motion category."""
        outcomes: dict[str, list[bool]] = {}
        for robot in ids.tolist():
            clip = int(self.reference.clip[self.frame[robot]])
            ended = outcomes.setdefault(self.reference.categories[clip], [])
            ended.append(not bool(terminated[robot]))
        return outcomes

    def _read(self) -> None:
        qpos, qvel, sensordata = self.physics.read()
        if self._terrain is not None:
            origin = torch.from_numpy(self._origin).to(sensordata)
            bodies = sensordata[:, self._layout.position]
            bodies -= origin.repeat(1, bodies.shape[1] // 3)
        self._state = read_state(self._layout, qpos, qvel, sensordata)

    def _push(self) -> None:
        """Kick some robots sideways (Table A2, push robot)."""
        chance = CONTROL_PERIOD / self.config.push_interval
        ids = np.flatnonzero(self._rng.random(self.num_envs) < chance)
        if len(ids) and self.config.push_speed > 0:
            kick = np.zeros((len(ids), 3))
            kick[:, :2] = self._rng.uniform(-1, 1, (len(ids), 2))
            self.physics.push(ids, kick * self.config.push_speed)

    def _failed(self, tracking: TrackingState) -> torch.Tensor:
        """(n,) bool: beyond the termination limits."""
        limits, torso = self.config.limits, g1.TORSO
        robot, reference = tracking.robot, tracking.reference
        height = robot.body_position[:, torso, 2] - reference.body_position[:, torso, 2]
        vertical = robot.body_quat.new_tensor([0.0, 0.0, 1.0])
        up = rotations.rotate(robot.body_quat[:, torso], vertical)
        up_wanted = rotations.rotate(reference.body_quat[:, torso], vertical)
        tilt = torch.arccos((up * up_wanted).sum(-1).clamp(-1, 1))
        angle = tracking.angles[:, torso]
        ends = [*g1.FEET, *g1.WRISTS]
        end_height = (
            robot.body_position[:, ends, 2] - reference.body_position[:, ends, 2]
        )
        distance = tracking.point_offsets.norm(dim=-1).mean(-1)
        # Robots born away from the reference get time to come closer.
        settling = self._displaced & (self.age < self._born_age + 150)
        strict = (
            (height.abs() > limits.height)
            | (angle > limits.angle)
            | (end_height.abs() > limits.end_effector).any(-1)
            | (distance > limits.distance)
        )
        loose = (
            (height < -2 * limits.height)
            | (tilt > 1.2)
            | (distance > limits.distance + 1.5)
        )
        return torch.where(settling, loose, strict)

    # Resetting -----------------------------------------------------------------------

    def _count_failures(self, terminated: torch.Tensor) -> None:
        """Keep the failure rate of each half-second bin as a moving average."""
        bins = self.frame // _BIN
        size = len(self.failures)
        self.failures *= 0.9995
        self._visits *= 0.9995
        self._visits += torch.bincount(bins, minlength=size) / _BIN
        if terminated.any():
            self.failures += torch.bincount(bins[terminated], minlength=size)

    def _sample_frames(self, count: int) -> torch.Tensor:
        """Start frames: partly where robots fail, partly uniform, up to 1 s earlier."""
        rate = (self.failures / (self._visits + 1.0)).clamp(max=0.5) + 0.01
        # Thousands of easy bins would outweigh the few hard ones.
        rate = rate**1.5
        share = self.config.failure_share
        chance = share * rate / rate.sum() + (1 - share) / len(rate)
        bins = torch.multinomial(
            chance, count, replacement=True, generator=self._torch_rng
        )
        offset = torch.randint(-_BIN, _BIN, (count,), generator=self._torch_rng)
        last_frame = self.reference.num_frames - 1
        wanted = (bins * _BIN).clamp(max=last_frame)
        first = torch.searchsorted(
            self.reference.clip, self.reference.clip[wanted].contiguous()
        )
        last = self.reference.last[wanted]
        latest = torch.maximum(first, last - _BIN)
        return torch.minimum(torch.maximum(wanted + offset, first), latest)

    def _reset(self, ids: torch.Tensor) -> None:
        """Start new episodes on (or near) the reference."""
        count, rng, config = len(ids), self._rng, self.config
        start = self._sample_frames(count)
        qpos = self.reference.qpos[start.numpy()].copy()
        qvel = self.reference.qvel[start.numpy()].copy()
        draw = rng.random(count)
        standing = draw < config.standing_share
        displaced = draw > 1.0 - config.displaced_share
        to_standing(qpos, qvel, standing)
        displace(
            qpos,
            qvel,
            displaced,
            rng,
            distance=config.born_distance,
            heading=config.born_heading,
            by_area=config.born_by_area,
        )
        qpos[:, 7:] += 0.05 * rng.standard_normal((count, g1.NUM_JOINTS))
        qpos[:, 2] += 0.01
        qvel[:, :6] += 0.1 * rng.standard_normal((count, 6))
        self.frame[ids] = start
        self.age[ids] = 0
        self._born_age[ids] = 0
        self._displaced[ids] = torch.from_numpy(standing | displaced)
        robots = ids.numpy()
        self._factory.rebuild(robots, torch.from_numpy(qpos[:, 7:]))
        if self._terrain is not None:
            terrain = self._terrain
            origin = terrain.origins(robots, qpos[:, :2], self._terrain_rng)
            self._origin[robots] = origin
            qpos[:, :3] += origin
            qpos[:, 2] += terrain.clearance(qpos[:, :2])
        self.physics.reset(robots, qpos, qvel)
        self._read()
        self.action[ids] = 0.0
        self._air_time[ids] = 0.0
