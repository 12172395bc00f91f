"""Two processes on one machine train one teacher (gloo)."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from openclone.training.checkpoint import load_checkpoint
from openclone.training.distributed import (
    Team,
    in_processes,
    team,
    threads_per_process,
)

pytestmark = pytest.mark.timeout(900)

_WORKER = """
import sys
from pathlib import Path

import torch
from openclone.motion.clip import load_clip
from openclone.training.distributed import joined
from openclone.training.presets import TEACHERS
from openclone.training.progress import Budget, Progress
from openclone.training.teacher import TeacherTrainer

out = Path(sys.argv[2])
with joined() as crew:
    trainer = TeacherTrainer([load_clip(Path(sys.argv[1]))], TEACHERS["smoke"], 0, 1)
    first = {k: v.clone() for k, v in trainer.ppo.actor.state_dict().items()}
    progress = Progress(out, Budget(float("inf"), 3))
    trainer.learn(progress, out / "teacher.pt")
    torch.save(
        {
            "first": first,
            "actor": trainer.ppo.actor.state_dict(),
            "critic": trainer.ppo.critic.state_dict(),
            "style": trainer.style.net.state_dict(),
            "angles": trainer.task.robot_state().joint_angles.clone(),
            "rate": trainer.ppo.learning_rate,
            "steps": progress.steps,
        },
        f"{out}/rank{crew.rank}.pt",
    )
    progress.close()
"""


def torchrun(*arguments):
    command = [sys.executable, "-m", "torch.distributed.run", "--nproc-per-node", "2"]
    command += ["--master-port", "0", "--rdzv-backend", "c10d"]
    command += ["--rdzv-endpoint", "localhost:0", *map(str, arguments)]
    result = subprocess.run(
        command,
        capture_output=True,
        text=True,
        timeout=600,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    assert result.returncode == 0, result.stderr[-3000:]
    return result.stdout


@pytest.fixture(scope="module")
def clip_file(tmp_path_factory, make_clip):
    from openclone.motion.clip import save_clip

    path = tmp_path_factory.mktemp("clips") / "sway.npz"
    save_clip(make_clip(), path)
    return path


def test_alone_nothing_is_shared():
    assert team() == Team(0, 1)
    assert Team().ppo_settings is None
    assert Team().agree(True) is True
    assert threads_per_process() == (os.cpu_count() or 1)


def test_processes_keep_one_policy_and_collect_their_own_data(clip_file, tmp_path):
    script = tmp_path / "worker.py"
    script.write_text(_WORKER)
    torchrun(script, clip_file, tmp_path)
    ours, theirs = (
        torch.load(tmp_path / f"rank{rank}.pt", weights_only=True) for rank in (0, 1)
    )
    weight = "mlp.0.weight"
    assert not torch.equal(ours["first"][weight], theirs["first"][weight])
    for part in ("actor", "critic", "style"):
        assert ours[part].keys() == theirs[part].keys()
        for name, value in ours[part].items():
            torch.testing.assert_close(theirs[part][name], value, atol=1e-6, rtol=0)
    assert not torch.equal(ours["actor"][weight], ours["first"][weight])
    assert ours["rate"] == theirs["rate"]
    assert not torch.equal(ours["angles"], theirs["angles"])
    # Both count the steps of both: 3 iterations of 4 steps of 16 robots.
    assert ours["steps"] == theirs["steps"] == 2 * 3 * 4 * 16
    assert len(list(tmp_path.glob("events.out.tfevents.*"))) == 1


def test_the_command_under_torchrun(clip_file, tmp_path):
    command = ["-m", "openclone.cli", "train", "teacher", "--preset", "smoke"]
    folder = Path(clip_file).parent
    said = torchrun(*command, "--motions", folder, "--out", tmp_path)
    assert said.count("1 clips") + said.count("2 clips") == 1
    content = load_checkpoint(tmp_path / "teacher.pt")
    # The preset's 3 iterations of 4 steps of 16 robots, in both processes.
    assert content["iterations"] == 3
    assert content["steps"] == 2 * 3 * 4 * 16
    weights = content["ppo"]["actor_state_dict"]["mlp.0.weight"]
    assert np.isfinite(weights.numpy()).all()


def test_the_command_starts_its_own_processes(clip_file, tmp_path):
    command = [sys.executable, "-m", "openclone.cli", "train", "teacher"]
    command += ["--preset", "smoke", "--processes", "2", "--out", str(tmp_path)]
    command += ["--motions", str(Path(clip_file).parent)]
    result = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert result.returncode == 0, result.stderr[-3000:]
    content = load_checkpoint(tmp_path / "teacher.pt")
    assert content["steps"] == 2 * 3 * 4 * 16


def test_processes_teach_one_student(clip_file, trained, tmp_path):
    command = [sys.executable, "-m", "openclone.cli", "train", "student"]
    command += ["--preset", "smoke", "--processes", "2", "--out", str(tmp_path)]
    command += ["--teacher", str(trained[1]), "--tuning-minutes", "0"]
    command += ["--motions", str(Path(clip_file).parent)]
    result = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert result.returncode == 0, result.stderr[-3000:]
    content = load_checkpoint(tmp_path / "student.pt")
    # The preset's 3 rounds of 4 steps of 16 robots, in both processes.
    assert content["steps"] == 2 * 3 * 4 * 16
    assert content["averaged_steps"] == 3 * 2
    assert (tmp_path / "student.onnx").is_file()


def test_one_process_that_fails_ends_the_others():
    script = (
        "import os, sys, time\n"
        "if os.environ['RANK'] == '1': sys.exit(3)\n"
        "time.sleep(600)"
    )
    assert in_processes(2, [sys.executable, "-c", script]) == 3
    script = "import os; assert os.environ['WORLD_SIZE'] == '3'"
    assert in_processes(3, [sys.executable, "-c", script]) == 0


_BOTH = """
import sys
from pathlib import Path

from openclone.cli import learning
from openclone.motion.clip import load_clip
from torch import distributed

join, joins = distributed.init_process_group, []
distributed.init_process_group = lambda *a: (joins.append(a), join(*a))
learning._training_clips = lambda _: [load_clip(Path(sys.argv[1]))]
learning.train_student(preset="smoke", out=Path(sys.argv[2]), threads=1)
assert len(joins) == 1, joins
"""


def test_teacher_and_student_share_one_team(clip_file, tmp_path):
    # Processes that parted after the teacher did not always find each other again.
    script = tmp_path / "both.py"
    script.write_text(_BOTH)
    torchrun(script, clip_file, tmp_path)
    assert load_checkpoint(tmp_path / "teacher" / "teacher.pt")["iterations"] == 3
    assert load_checkpoint(tmp_path / "student.pt")["phase"] == "tuning"
