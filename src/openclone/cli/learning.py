"""Commands that train: train teacher, train student."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from openclone.cli.options import load_clips, positive, synthetic_clips

if TYPE_CHECKING:
    from openclone.motion.clip import Clip


def _training_clips(motions: tuple[Path, ...]) -> list[Clip]:
    if motions:
        return load_clips(motions, "train", "")
    print("no --motions: training on synthetic motions")
    return synthetic_clips(0, 10.0)


def train_teacher(
    *,
    preset: str = "fast",
    motions: tuple[Path, ...] = (),
    out: Path = Path("runs/teacher"),
    minutes: float | None = None,
    resume: bool = False,
    seed: int = 0,
    threads: int | None = None,
) -> None:
    """Train the privileged teacher with PPO.

    Args:
        preset: fast, quickstart or smoke.
        motions: folders of recordings with a manifest.tsv (split train), or of clip
            files; by default synthetic motions.
        out: folder for the checkpoint and the event files.
        minutes: wall time instead of the preset's, earlier runs included.
        resume: go on from the checkpoint in the folder.
        seed: of all randomness.
        threads: CPU threads; all cores by default.
    """
    from openclone.training import teacher
    from openclone.training.presets import teacher_preset

    positive("--minutes", minutes)
    settings = teacher_preset(preset)
    path = teacher.train_teacher(
        _training_clips(motions),
        settings,
        out,
        minutes=minutes,
        resume=resume,
        seed=seed,
        threads=threads,
    )
    print(f"teacher: {path}")


def train_student(
    *,
    preset: str = "fast",
    teacher: Path = Path("runs/teacher/teacher.pt"),
    motions: tuple[Path, ...] = (),
    out: Path = Path("runs/student"),
    minutes: float | None = None,
    tuning_minutes: float | None = None,
    resume: bool = False,
    seed: int = 0,
    threads: int | None = None,
) -> None:
    """Train the student from a teacher: DAgger, then PPO; exports its bundle.

    Args:
        preset: fast, quickstart or smoke.
        teacher: checkpoint of `openclone train teacher`.
        motions: as for the teacher.
        out: folder for checkpoint, bundle and event files.
        minutes: wall time of DAgger instead of the preset's.
        tuning_minutes: wall time of PPO instead of the preset's; 0 for none.
        resume: go on from the checkpoint in the folder.
        seed: of all randomness.
        threads: CPU threads; all cores by default.
    """
    import warnings

    from openclone.training import student
    from openclone.training.presets import student_preset

    # torch's ONNX exporter warns about itself at every checkpoint.
    warnings.filterwarnings("ignore", message=".*treespec, LeafSpec")
    positive("--minutes", minutes)
    settings = student_preset(preset)
    path = student.train_student(
        _training_clips(motions),
        teacher,
        settings,
        out,
        minutes=minutes,
        tuning_minutes=tuning_minutes,
        resume=resume,
        seed=seed,
        threads=threads,
    )
    print(f"policy bundle: {path}")
