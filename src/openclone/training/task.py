"""The tracking task: follow the reference motions, many robots at a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch

from openclone.policy.command import Command, command_of
from openclone.policy.constants import Constant
from openclone.policy.teacher import (
    command_observation,
    legs_observation,
    preview,
    teacher_observation,
)
from openclone.robot import g1
from openclone.robot.model import CONTROL_PERIOD, SensorLayout
from openclone.robot.state import RobotState, read_state
from openclone.training.births import displace, to_standing
from openclone.training.feedback import corrections, deviation
from openclone.training.guidance import guided
from openclone.training.hardware import on_one_thread
from openclone.training.physics import Physics
from openclone.training.randomization import ActionPath, RobotFactory
from openclone.training.reference import ReferenceMotions
from openclone.training.reward_table import total_reward
from openclone.training.rewards import TrackingState
from openclone.training.starts import StartFrames
from openclone.training.task_config import Guidance, TaskConfig
from openclone.training.task_config import TerminationLimits as TerminationLimits
from openclone.training.termination import lost
from openclone.training.terrain import Terrain

_SETTLING_STEPS = 150
"""Robots born away from the reference get so long to come closer."""
_FAR = 6.0
"""Bound on the actions of feedback."""
_ACTION_SCALE = Constant(g1.ACTION_SCALE)


@dataclass(frozen=True)
class StepResult:
    """What one control step brought, n robots; all on the task's device.

    Attributes:
        reward: (n,).
        terminated: (n,) bool, failed.
        timed_out: (n,) bool, episode or clip over without failure.
        pushed: (n,) bool, robots that were pushed before the step.
        terms: mean of each reward term, per second, scalars.
        error: metres, mean key-body error in the world, a scalar.
        category: (n,), number of the motion category that each robot was tracking.
        ended: (k,), the robots that were reset; on the CPU.
    """

    reward: torch.Tensor
    terminated: torch.Tensor
    timed_out: torch.Tensor
    pushed: torch.Tensor
    terms: dict[str, torch.Tensor]
    error: torch.Tensor
    category: torch.Tensor
    ended: torch.Tensor

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
        self.device = physics.device
        self.reference = reference = reference.to(self.device)
        self.physics = physics
        self.config = config
        self.num_envs = n = physics.num_envs
        self._layout = layout
        self._rng = np.random.default_rng(seed)
        self._torch_rng = torch.Generator().manual_seed(seed)
        # Streams of its own, so that a range of zero leaves all other draws alone.
        stream = np.random.default_rng([seed, 2])
        self._terrain, self._terrain_rng = terrain, np.random.default_rng([seed, 3])
        self._look_rng = np.random.default_rng([seed, 4])
        self._origin = torch.zeros(n, 1, 3, device=self.device)
        delays = torch.Generator(self.device).manual_seed(seed + 1)
        self._path = ActionPath(config.randomization, n, delays)
        self._factory = RobotFactory(config.randomization, physics, self._path, stream)
        ages = torch.randint(0, config.episode_steps, (n,), generator=self._torch_rng)
        self.starts = StartFrames(
            reference,
            config.failure_share,
            self._torch_rng,
            config.recorded_weight,
            config.run_up,
        )
        self.frame = torch.zeros(n, dtype=torch.long, device=self.device)
        self.age = torch.zeros_like(self.frame)
        self.action = torch.zeros(n, g1.NUM_JOINTS, device=self.device)
        self.action_scale = _ACTION_SCALE.like(self.action)
        self.style: Style | None = None
        self._preview = torch.tensor(config.preview, device=self.device)
        self._air_time = torch.zeros(n, 2, device=self.device)
        self._displaced = torch.zeros(n, dtype=torch.bool, device=self.device)
        self.look = torch.ones(n, device=self.device)
        self._born_age = torch.zeros_like(self.frame)
        self._following: torch.Tensor | None = None
        self._looked_up: RobotState | None = None
        self._reset(torch.arange(n))
        # Spread the episodes' ends, so that resets do not come all at once.
        self.age = ages.to(self.device)
        self._born_age = self.age.clone()

    # What the policies see -----------------------------------------------------------

    def robot_state(self) -> RobotState:
        """Current states of the robots, float32."""
        return self._state

    def jump_to(self, frame: torch.Tensor) -> None:
        """Put the reference of every robot at ``frame (n,)``; the robots stay."""
        self.frame = frame.to(self.device)
        self._following = self._looked_up = None

    def next_frame(self) -> torch.Tensor:
        """(n,) index of the reference frame for the next step, t + 1."""
        if self._following is None:
            last = self.reference.last[self.frame]
            self._following = torch.minimum(self.frame + 1, last)
        return self._following

    def next_reference(self) -> RobotState:
        """Reference states at t + 1; observing and stepping ask for the same ones."""
        if self._looked_up is None:
            self._looked_up = self.reference.at(self.next_frame())
        return self._looked_up

    def residual_to_target(self, action: torch.Tensor) -> torch.Tensor:
        """Joint targets of the teacher's action: an offset to `base_targets`."""
        return self.base_targets() + self.action_scale * action

    def feedback_action(self) -> torch.Tensor:
        """(n, 29): the teacher's action that holds the robot near the reference.

        Its joint targets are those of feed-forward and linear feedback.

        Raises:
            ValueError: the reference has no feedback gains.
        """
        gains = self.reference.feedback
        if gains is None:
            raise ValueError("the task needs a reference with feedback gains")
        away = deviation(self._state, self.reference.at(self.frame))
        held = self._guided("feedforward")
        held = held + corrections(gains.index_select(0, self.frame), away)
        return ((held - self.base_targets()) / self.action_scale).clamp(-_FAR, _FAR)

    def base_targets(self) -> torch.Tensor:
        """(n, 29): joint targets of the configured guidance."""
        return self._guided(self.config.guidance)

    def _guided(self, guidance: Guidance) -> torch.Tensor:
        ahead = self.reference.feedforward.index_select(0, self.next_frame())
        return guided(guidance, self._state, self.next_reference(), ahead)

    @on_one_thread
    def teacher_observation(self) -> torch.Tensor:
        """(n, d): what the teacher sees, by the configured view."""
        if self.config.view == "reference":
            return self.reference_observation()
        reference = self.next_reference()
        return self.observe_command(self._state, reference, self.look, self.action)

    def observe_command(
        self,
        robot: RobotState,
        reference: RobotState,
        look: torch.Tensor,
        action: torch.Tensor,
    ) -> torch.Tensor:
        """(n, d): any ``robot``, and head and hands, perhaps legs, of ``reference``."""
        seen = command_observation(robot, command_of(reference, look), action)
        if self.config.view == "legs":
            seen = torch.cat((seen, legs_observation(robot, reference)), 1)
        return seen

    def command(self) -> Command:
        """What the operators of all robots ask for at t + 1."""
        return command_of(self.next_reference(), self.look)

    @on_one_thread
    def reference_observation(self) -> torch.Tensor:
        """(n, d): the privileged observation of section 3.1, and the preview."""
        return self.observe_reference(self._state, self.next_frame(), self.action)

    def observe_reference(
        self, robot: RobotState, following: torch.Tensor, action: torch.Tensor
    ) -> torch.Tensor:
        """The same of any ``robot`` (n, ...) before the frame ``following (n,)``."""
        reference = self.reference.at(following)
        last = self.reference.last[following]
        ahead = torch.minimum(following + self.config.lead_frames, last)
        torso = self.reference.frames.body_position[:, g1.TORSO]
        lead = torso.index_select(0, ahead) - reference.body_position[:, g1.TORSO]
        lead[:, 2] = 0.0
        shifted = replace(
            reference, body_position=reference.body_position + lead[:, None]
        )
        seen = teacher_observation(robot, shifted, action)
        if not self.config.preview:
            return seen
        moments = torch.minimum(following[:, None] + self._preview, last[:, None])
        later = self.reference.landmarks.index_select(0, moments.flatten())
        later = later.unflatten(0, moments.shape)
        return torch.cat((seen, preview(robot, later)), 1)

    # Stepping ------------------------------------------------------------------------

    @on_one_thread
    def step(self, targets: torch.Tensor) -> StepResult:
        """Advance one control period towards ``targets (n, 29)``, then reset the dead.

        Returns:
            Rewards and flags of the step; observations afterwards belong to the new
            episodes where ``done`` is set.
        """
        following, reference = self.next_frame(), self.next_reference()
        previous_action = self.action
        self.action = (targets - self.base_targets()) / self.action_scale
        before = self._state
        pushed = self._push()
        self.physics.step(self._path(targets))
        self.jump_to(following)
        self.age += 1
        self._read()
        tracking = TrackingState(
            robot=self._state,
            reference=reference,
            action=self.action,
            previous_action=previous_action,
            previous_velocities=before.joint_velocities,
            terminated=torch.zeros_like(self._displaced),
            air_time=self._air_time,
            style=self._style_reward(before),
            period=CONTROL_PERIOD,
        )
        settling = self._displaced & (self.age < self._born_age + _SETTLING_STEPS)
        failed = lost(tracking, self.config.limits, settling)
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
        self.starts.count(self.frame, terminated)
        error = (self._state.body_position - reference.body_position).norm(dim=-1)
        means = torch.stack(tuple(terms.values())).mean(-1).unbind()
        category = self.reference.category[self.frame]
        ended = torch.nonzero((terminated | timed_out).cpu()).squeeze(-1)
        if len(ended):
            self._reset(ended)
        return StepResult(
            reward=reward,
            terminated=terminated,
            timed_out=timed_out,
            pushed=pushed,
            terms=dict(zip(terms, means, strict=True)),
            error=error.mean(),
            category=category,
            ended=ended,
        )

    def _style_reward(self, before: RobotState) -> torch.Tensor:
        if self.style is None:
            return self._air_time.new_zeros(self.num_envs)
        return self.style(before, self._state)

    def _read(self) -> None:
        qpos, qvel, sensordata = self.physics.read()
        if self._terrain is not None:
            bodies = sensordata[:, self._layout.position].unflatten(1, (-1, 3))
            bodies -= self._origin
        self._state = read_state(self._layout, qpos, qvel, sensordata)

    def _push(self) -> torch.Tensor:
        """Kick some robots sideways (Table A2, push robot); which ones, (n,) bool."""
        chance = CONTROL_PERIOD / self.config.push_interval
        chosen = self._rng.random(self.num_envs) < chance
        chosen &= self.config.push_speed > 0
        ids = np.flatnonzero(chosen)
        if len(ids):
            kick = np.zeros((len(ids), 3))
            kick[:, :2] = self._rng.uniform(-1, 1, (len(ids), 2))
            self.physics.push(ids, kick * self.config.push_speed)
        return torch.from_numpy(chosen).to(self.device)

    def copy(self, sources: torch.Tensor) -> None:
        """Put every robot where robot ``sources (n,)[robot]`` is, with its past."""
        self.physics.copy(sources.cpu().numpy())
        self._path.copy(sources)
        ages, births = (self.age, self._born_age), (self._displaced, self.look)
        for part in (*ages, *births, self.action, self._air_time, self._origin):
            part[:] = part[sources]
        self.jump_to(self.frame[sources])
        self._read()

    # Resetting -----------------------------------------------------------------------

    def _reset(self, ids: torch.Tensor) -> None:
        """Start new episodes of the robots ``ids`` (CPU) on or near the reference."""
        count, rng, config = len(ids), self._rng, self.config
        start = self.starts.draw(count)
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
        robots, chosen = ids.numpy(), ids.to(self.device)
        self._factory.rebuild(robots, torch.from_numpy(qpos[:, 7:]))
        if self._terrain is not None:
            terrain = self._terrain
            origin = terrain.origins(robots, qpos[:, :2], self._terrain_rng)
            self._origin[chosen, 0] = torch.from_numpy(origin).to(self._origin)
            qpos[:, :3] += origin
            qpos[:, 2] += terrain.clearance(qpos[:, :2])
        self.physics.reset(robots, qpos, qvel)
        frame = self.frame.clone()
        frame[chosen] = start.to(self.device)
        self.jump_to(frame)
        away = torch.from_numpy(standing | displaced)
        self._displaced[chosen] = away.to(self.device)
        look = self._look_rng.random(count) < config.look_share
        self.look[chosen] = torch.from_numpy(look).to(self.look)
        for counter in (self.age, self._born_age, self.action, self._air_time):
            counter[chosen] = 0
        self._read()
