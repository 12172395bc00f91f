"""The world model's derivatives beside MuJoCo's, and how far value gradients agree.

The shipped student explores the default motions; a world model learns from it. Then, in
states that it has not seen, its derivatives of the velocities after a control step are
compared with central differences of MuJoCo: cosine of the two matrices and ratio of
their sizes, medians, by what is varied and by how much. Last, how far the gradients of
single roll-outs of the tuned student agree: the mean cosine of all pairs.
"""

from __future__ import annotations

import argparse
import json
import platform
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import mujoco
import numpy as np
import torch

from openclone.motion.sources.synthetic import default_set
from openclone.robot.model import SUBSTEPS
from openclone.spatial import rotations
from openclone.training.pilots import StudentPilot
from openclone.training.presets import STUDENTS
from openclone.training.student import StudentTrainer
from openclone.training.teacher import load_critic
from openclone.training.teacher_view import CRITIC
from openclone.training.terrain import build_training_model
from openclone.training.value_gradient import Repetition, Tuner
from openclone.training.windows import Window
from openclone.training.world_model import WorldModel

WEIGHTS = Path(str(files("openclone") / "weights"))
VARIED = {"joint targets": 29, "velocities": 35, "positions": 35}
SIZES = (1e-3, 2e-2)
"""Radians, metres, and those per second."""


class Steps:
    """MuJoCo's velocities after a control step."""

    def __init__(self) -> None:
        self._model = build_training_model()
        self._data = mujoco.MjData(self._model)

    def __call__(self, row: np.ndarray, varied: str, by: np.ndarray) -> np.ndarray:
        """From the state and the joint targets in ``row (100,)``, varied ``by``."""
        model, data = self._model, self._data
        qpos, qvel, targets = np.split(row.copy(), (36, 71))
        if varied == "positions":
            mujoco.mj_integratePos(model, qpos, by, 1.0)
        if varied == "velocities":
            qvel += by
        if varied == "joint targets":
            targets += by
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:], data.ctrl[:] = qpos, qvel, targets
        for _ in range(SUBSTEPS):
            mujoco.mj_step(model, data)
        return data.qvel.copy()

    def derivative(self, row: np.ndarray, varied: str, size: float) -> np.ndarray:
        """Central differences, (35, k)."""
        columns = [
            (self(row, varied, by) - self(row, varied, -by)) / (2 * size)
            for by in size * np.eye(VARIED[varied])
        ]
        return np.stack(columns, 1)


def foreseen(model: WorldModel, row: torch.Tensor, varied: str) -> np.ndarray:
    """The same of the world model."""
    qpos, qvel, targets = (part[None] for part in row.split((36, 35, 29)))

    def velocities(by: torch.Tensor) -> torch.Tensor:
        place, speed, wanted = qpos, qvel, targets
        if varied == "positions":
            turn = rotations.from_rotation_vector(by[None, 3:6])
            quat = rotations.multiply(qpos[:, 3:7], turn)
            place = torch.cat((qpos[:, :3] + by[:3], quat, qpos[:, 7:] + by[6:]), 1)
        if varied == "velocities":
            speed = qvel + by
        if varied == "joint targets":
            wanted = targets + by
        return model(place, speed, wanted)[1][0]

    nothing = torch.zeros(VARIED[varied])
    return torch.autograd.functional.jacobian(velocities, nothing).double().numpy()  # type: ignore[union-attr]


def derivatives(
    model: WorldModel, window: Window, count: int
) -> dict[str, list[float]]:
    """Cosine and ratio for each kind of variation and size."""
    known = (window.qpos[:-1], window.qvel[:-1], window.targets)
    rows = torch.cat([part.flatten(0, 1) for part in known], 1)
    rows = rows[torch.randperm(len(rows))[:count]]
    steps, found = Steps(), {}
    for varied in VARIED:
        for size in SIZES:
            pairs = [
                (
                    steps.derivative(row.double().numpy(), varied, size),
                    foreseen(model, row, varied),
                )
                for row in rows
            ]
            sizes = [[np.linalg.norm(part) for part in pair] for pair in pairs]
            cosines = [
                (a * b).sum() / (x * y)
                for (a, b), (x, y) in zip(pairs, sizes, strict=True)
            ]
            ratios = [y / x for x, y in sizes]
            medians = [float(np.median(cosines)), float(np.median(ratios))]
            found[f"{varied}, {size:g}"] = medians
    return found


def agreement(tuner: Tuner, windows: list[Window]) -> float:
    """Mean cosine of the gradients of two roll-outs."""
    parameters = [p for p in tuner.pilot.network.parameters() if p.requires_grad]
    rows = []
    for window in windows:
        parts = torch.autograd.grad(Repetition(tuner, window).gain(), parameters)
        row = torch.cat([part.flatten() for part in parts])
        rows.append(row / row.norm())
    count = len(rows)
    total = torch.stack(rows).sum(0).square().sum()
    return float((total - count) / (count * (count - 1)))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, default=128)
    parser.add_argument("--roll-outs", type=int, default=50, help="to learn from")
    parser.add_argument("--states", type=int, default=48)
    parser.add_argument("--minutes", type=float, default=5.0, help="of motions")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    print(f"{platform.machine()}, Python {platform.python_version()}, ", end="")
    print(f"MuJoCo {mujoco.__version__}, PyTorch {torch.__version__}")
    torch.manual_seed(0)
    preset = STUDENTS["fast"]
    task = replace(preset.tuning_task, num_envs=options.robots)
    preset = replace(preset, tuning_task=task)
    with tempfile.TemporaryDirectory() as folder:
        clips = default_set(0, options.minutes)
        trainer = StudentTrainer(clips, preset, Path(folder), 0, None)
        trainer.begin(WEIGHTS / "student.onnx")
        critic = load_critic(WEIGHTS / "teacher.pt", CRITIC, task)
        view = trainer.view(task)
        pilot = StudentPilot(view, trainer.student)
        tuner = Tuner(pilot, critic, preset.tuning, 0, Path(folder))
        act: Callable[[], Window] = tuner.act
        start = time.perf_counter()
        for _ in range(options.roll_outs):
            loss = tuner.learn_physics(act())
        print(
            f"{options.roll_outs} roll-outs of {options.robots} robots, "
            f"{time.perf_counter() - start:.0f} s, loss {loss:.4f}"
        )
        found: dict[str, object] = dict(
            derivatives(tuner.learner.model, act(), options.states)
        )
        for name, pair in found.items():
            cosine, ratio = pair  # type: ignore[misc]
            print(f"{name:22s} cosine {cosine:.2f}  size {ratio:.2f}")
        found["agreement"] = agreement(tuner, [act() for _ in range(8)])
        print(f"gradients of two roll-outs agree by {found['agreement']:.2f}")
    if options.json:
        options.json.write_text(json.dumps(found, indent=2))


if __name__ == "__main__":
    main()
