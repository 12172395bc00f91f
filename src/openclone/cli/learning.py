"""Commands that train: train teacher, train student, train model, train plan."""

from __future__ import annotations

import os
import sys
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING

from openclone.cli.options import (
    category_names,
    load_clips,
    not_negative,
    positive,
    synthetic_clips,
    write_figures,
)
from openclone.errors import InputError

if TYPE_CHECKING:
    from openclone.motion.clip import Clip
    from openclone.training.data_choice import DataChoice
    from openclone.training.hardware import Hardware
    from openclone.training.plan import PhasePlan
    from openclone.training.presets import StudentPreset

_DEFAULT_TEACHER = Path("runs/teacher/teacher.pt")


def wait_passively() -> None:
    """Let torch's threads sleep between tasks; call before torch is imported.

    By default they spin. When another process takes one of two cores, training then
    falls from 4 500 to 250 steps/s; sleeping threads keep 4 000.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    os.environ.setdefault("GOMP_SPINCOUNT", "0")


_GLIDING = 4
"""Laps of 45 s among 10 minutes of synthetic motions."""


def _training_clips(motions: tuple[Path, ...]) -> list[Clip]:
    if motions:
        return load_clips(motions, "train", "", apart=True)
    from openclone.motion.sources.gliding import gliding_set

    print("no --motions: training on synthetic motions")
    return synthetic_clips(0, 10.0) + gliding_set(0, _GLIDING)


def _narrowed(data: DataChoice, categories: str) -> DataChoice:
    from openclone.motion.clip import CATEGORIES

    names = category_names(categories)
    for name in names or ():
        if name not in CATEGORIES:
            raise InputError(
                f"unknown category {name!r}", remedy="use " + ", ".join(CATEGORIES)
            )
    return replace(data, categories=names) if names else data


def train_teacher(
    *,
    preset: str = "fast",
    motions: tuple[Path, ...] = (),
    out: Path = Path("runs/teacher"),
    minutes: float | None = None,
    tuning_minutes: float | None = None,
    categories: str = "",
    resume: bool = False,
    start: Path | None = None,
    seed: int = 0,
    threads: int | None = None,
    processes: int = 1,
    physics: str = "auto",
    device: str = "cpu",
    model: Path | None = None,
) -> None:
    """Train the privileged teacher with PPO, then value gradients if wanted.

    Args:
        preset: fast, fast-amp, quickstart, feedback, other-data, paper or smoke.
        motions: folders of recordings with a manifest.tsv (split train), or of clip
            files; by default synthetic motions.
        out: folder for the checkpoint and the event files.
        minutes: wall time of PPO instead of the preset's, in all; 0: none.
        tuning_minutes: wall time of value gradients instead of the preset's; 0: none.
        categories: motion categories instead of the preset's, e.g. forward,turn.
        resume: go on from the checkpoint in the folder.
        start: begin with the networks of this checkpoint and a fresh budget.
        seed: of all randomness.
        threads: CPU threads; all cores by default.
        processes: that train together, each with the preset's robots and its own copy
            of the motions. With lanes, one per core is quickest.
        physics: lanes (sixteen robots at a time on each core; needs a C compiler),
            threaded (MuJoCo on the cores), warp (MuJoCo Warp, on the device), or auto:
            lanes where they are possible, else threaded.
        device: of task, networks and physics "warp": cpu, cuda or cuda:<number>.
        model: the robot as written by `openclone train model`, where mjlab is missing.
    """
    if _again_in(processes):
        return
    from openclone.training import teacher
    from openclone.training.presets import teacher_preset

    _check_minutes(minutes, tuning_minutes)
    settings = teacher_preset(preset)
    settings = replace(settings, data=_narrowed(settings.data, categories))
    path = teacher.train_teacher(
        _training_clips(motions),
        settings,
        out,
        minutes=minutes,
        tuning_minutes=tuning_minutes,
        resume=resume,
        start=start,
        seed=seed,
        threads=threads,
        hardware=_hardware(physics, device, model),
    )
    print(f"teacher: {path}")


def _check_minutes(minutes: float | None, tuning_minutes: float | None) -> None:
    not_negative("--minutes", minutes)
    not_negative("--tuning-minutes", tuning_minutes)


def _again_in(processes: int) -> bool:
    """Run this command in several processes, if they are wanted; whether it was done.

    Call it before torch is imported.

    Raises:
        InputError: their number is not positive.
        SystemExit: one of them failed, and has said why.
    """
    wait_passively()
    positive("--processes", processes)
    if processes == 1 or "WORLD_SIZE" in os.environ:
        return False
    from openclone.training.distributed import in_processes

    status = in_processes(
        processes, [sys.executable, "-m", "openclone.cli", *sys.argv[1:]]
    )
    if status:
        raise SystemExit(status)
    return True


def _hardware(physics: str, device: str, model: Path | None) -> Hardware:
    from openclone.training.hardware import Hardware

    hardware = Hardware(physics, device, model)
    hardware.torch_device()
    return hardware


def train_model(*, out: Path = Path("g1.mjb")) -> None:
    """Write the robot as one file, to train where mjlab is not installed.

    Args:
        out: file in MuJoCo's binary format, for the same version of MuJoCo.
    """
    from openclone.training.terrain import save_training_model

    save_training_model(out)
    print(f"model: {out}")


def train_student(
    *,
    preset: str = "fast",
    teacher: Path | None = None,
    motions: tuple[Path, ...] = (),
    out: Path = Path("runs/student"),
    minutes: float | None = None,
    tuning_minutes: float | None = None,
    categories: str = "",
    resume: bool = False,
    start: Path | None = None,
    seed: int = 0,
    threads: int | None = None,
    processes: int = 1,
    physics: str = "auto",
    device: str = "cpu",
    model: Path | None = None,
) -> None:
    """Train the student (DAgger, then value gradients if wanted); exports a bundle.

    Args:
        preset: fast, quickstart, real-odometry, paper, smoke or an ablation.
        teacher: checkpoint; runs/teacher/teacher.pt, or quickstart's own, by default.
        motions: as for the teacher.
        out: folder for checkpoint, bundle and event files.
        minutes: wall time of DAgger instead of the preset's; 0: none.
        tuning_minutes: wall time of value gradients instead of the preset's; 0: none.
        categories: motion categories instead of the preset's, e.g. forward,turn.
        resume: go on from the checkpoint in the folder.
        start: begin with the student of this checkpoint or bundle, with a fresh budget.
        seed: of all randomness.
        threads: CPU threads; all cores by default.
        processes: as for the teacher.
        physics: as for the teacher.
        device: as for the teacher.
        model: as for the teacher.
    """
    if _again_in(processes):
        return
    from openclone.training import distributed, student

    settings = _student_settings(preset, categories, minutes, tuning_minutes)
    clips, hardware = _training_clips(motions), _hardware(physics, device, model)
    with distributed.joined(hardware.torch_device()):
        if teacher is None:
            teacher = _teacher(settings, clips, out, resume, seed, threads, hardware)
            resume &= not settings.teacher or (out / student.CHECKPOINT).is_file()
        basis = clips, teacher, settings, out
        path = student.train_student(
            *basis,
            minutes=minutes,
            tuning_minutes=tuning_minutes,
            resume=resume,
            start=start,
            seed=seed,
            threads=threads,
            hardware=hardware,
        )
    print(f"policy bundle: {path}")


def _student_settings(
    preset: str, categories: str, minutes: float | None, tuning_minutes: float | None
) -> StudentPreset:
    from openclone.training.presets import student_preset

    _check_minutes(minutes, tuning_minutes)
    _hush_exporter()
    settings = student_preset(preset)
    return replace(settings, data=_narrowed(settings.data, categories))


def _hush_exporter() -> None:
    """Keep torch's ONNX exporter from warning about itself at every checkpoint."""
    import warnings

    warnings.filterwarnings("ignore", message=".*treespec, LeafSpec")


def _teacher(
    settings: StudentPreset,
    clips: list[Clip],
    out: Path,
    resume: bool,
    seed: int,
    threads: int | None,
    hardware: Hardware,
) -> Path:
    """Train the teacher that the student's preset names; otherwise the default one.

    A run that was interrupted in its teacher has no student yet. Processes that part
    after it may not find each other again: the caller's team does both.
    """
    if not settings.teacher:
        return _DEFAULT_TEACHER
    from openclone.training import teacher
    from openclone.training.presets import teacher_preset

    choice = teacher_preset(settings.teacher)
    choice = replace(
        choice, data=replace(choice.data, categories=settings.data.categories)
    )
    folder = out / "teacher"
    known = (folder / teacher.CHECKPOINT).is_file()
    print(f"first the teacher ({settings.teacher}), in {folder}")
    return teacher.train_teacher(
        clips,
        choice,
        folder,
        resume=resume and known,
        seed=seed,
        threads=threads,
        hardware=hardware,
    )


def train_plan(
    *,
    preset: str = "fast",
    seconds: float = 5.0,
    motion_minutes: float = 30.0,
    threads: int | None = None,
    json: Path | None = None,
) -> None:
    """Steps, memory and time of a preset on this machine, from a short measurement.

    Args:
        preset: of the teacher, the student or both.
        seconds: length of the measurement of each phase.
        motion_minutes: length of the training motions, for the memory and the gains.
        threads: CPU threads; all cores by default.
        json: also write the figures to this file.
    """
    wait_passively()
    from openclone.training import plan
    from openclone.training.presets import STUDENTS, TEACHERS

    positive("--seconds", seconds)
    positive("--motion-minutes", motion_minutes)
    if preset not in TEACHERS and preset not in STUDENTS:
        names = ", ".join(dict.fromkeys((*TEACHERS, *STUDENTS)))
        raise InputError(f"unknown preset {preset!r}", remedy=f"use one of {names}")
    teacher, student = TEACHERS.get(preset), STUDENTS.get(preset)
    phases: list[PhasePlan] = []
    if teacher is not None:
        phases += plan.plan_teacher(teacher, seconds, motion_minutes, threads)
    if student is not None:
        phases += plan.plan_student(student, seconds, motion_minutes, threads)
    available = plan.machine_memory_mb()
    _print_plan(phases, available)
    rows = [asdict(phase) for phase in phases]
    write_figures(json, {"preset": preset, "memory_mb": available, "phases": rows})


def _print_plan(phases: list[PhasePlan], available_mb: float) -> None:
    print(f"{'phase':16} {'robots':>6} {'steps/s':>8} {'steps':>9} {'memory':>9}  time")
    for phase in phases:
        print(
            f"{phase.phase:16} {phase.robots:6d} {phase.steps_per_s:8.0f} "
            f"{phase.steps / 1e6:7.2f} M {phase.memory_mb:6.0f} MB  "
            f"{_duration(phase.minutes)}"
        )
    print(f"{'all':16} {_duration(sum(phase.minutes for phase in phases)):>46}")
    most = max(phase.memory_mb for phase in phases)
    if most > available_mb:
        print(f"this machine has {available_mb:.0f} MB: too little memory")


def _duration(minutes: float) -> str:
    """Minutes in the unit that suits them."""
    for name, length in (("years", 525_600), ("days", 1440), ("hours", 60)):
        if minutes >= 1.5 * length:
            return f"{minutes / length:.1f} {name}"
    return f"{minutes:.1f} minutes"
