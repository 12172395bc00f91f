"""Commands that make and convert motions: synthesize, retarget, export, import."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from openclone.cli.options import load_clips, positive
from openclone.errors import InputError

if TYPE_CHECKING:
    from openclone.motion.clip import Clip


def file_name(clip: Clip) -> str:
    """Name of a clip's file: the clip's name on one level."""
    return f"{clip.info.name.replace('/', '__')}.npz"


def motions_synthesize(
    *,
    out: Path,
    seed: int = 0,
    minutes: float = 30.0,
    gliding: int = 0,
    deep_squats: int = 0,
    free_hands: int = 0,
    workers: int | None = None,
) -> None:
    """Make the default synthetic motions and write them as clip files.

    Args:
        out: folder for the clips.
        seed: equal seeds give equal motions.
        minutes: least length of all motions together.
        gliding: also so many gliding laps of 45 s: the standing body carried along as
            an operator's head moves, feet sliding on purpose. For training only.
        deep_squats: also so many squats to heads of 0.6 to 0.75 m, every other one, on
            purpose, up to 0.17 m into the ground: for training.
        free_hands: also so many motions whose hands go wherever arms can, above the
            head too, while the body sways, leans or walks.
        workers: processes; one per core by default. The result is the same.
    """
    from openclone.motion.batch import available_workers
    from openclone.motion.clip import save_clip
    from openclone.motion.sources.deep_squats import deep_squat_set
    from openclone.motion.sources.free_hands import free_hands_set
    from openclone.motion.sources.gliding import gliding_set
    from openclone.motion.sources.synthetic import default_set

    positive("--minutes", minutes)
    extras = {"gliding": gliding, "deep-squats": deep_squats, "free-hands": free_hands}
    for option, count in extras.items():
        if count < 0:
            raise InputError(f"--{option} is {count}", remedy="give 0 or more")
    positive("--workers", workers)
    workers = workers or available_workers()
    clips = default_set(seed, minutes, workers=1 if minutes < 3 else workers)
    clips += gliding_set(seed, gliding) + deep_squat_set(seed, deep_squats)
    clips += free_hands_set(seed, free_hands)
    for clip in clips:
        save_clip(clip, out / file_name(clip))
    total = sum(clip.seconds for clip in clips) / 60
    print(f"{len(clips)} clips, {total:.1f} minutes, in {out}")


def motions_retarget(
    source: Path,
    /,
    *,
    out: Path,
    category: str = "transition",
    licence: str = "unknown",
) -> None:
    """Turn a human recording, or a folder with a manifest, into clips of the G1.

    Args:
        source: recording (.bvh, .amc with its .asf beside it, .mvnx, AMASS .npz,
            DeepMimic .txt), or a folder with a manifest.tsv.
        out: folder for the clips.
        category: what a single recording shows.
        licence: licence and credit of a single recording.
    """
    from openclone.motion import library
    from openclone.motion.clip import ClipInfo, save_clip
    from openclone.motion.retarget import retarget

    if source.is_dir():
        for split in sorted({entry.split for entry in library.read_manifest(source)}):
            clips = load_clips((source,), split, "")
            for clip in clips:
                save_clip(clip, out / split / file_name(clip))
            print(f"{split}: {len(clips)} clips in {out / split}")
        return
    motion = library.read_recording(source)
    info = ClipInfo(source.stem, category, source.name, licence, motion.fps)
    clip, quality = retarget(motion, info)
    save_clip(clip, out / file_name(clip))
    print(f"{out / file_name(clip)}: {clip.seconds:.1f} s, {quality}")


def motions_export(
    clip: Path,
    /,
    *,
    format: Literal["csv", "mjlab", "beyondmimic", "gmr"],
    out: Path,
    fps: float | None = None,
) -> None:
    """Write a clip in another project's format.

    Args:
        clip: the clip file.
        format: csv: position, quaternion xyzw and 29 joints per row (Unitree's sets,
            mjlab's csv_to_npz); mjlab, beyondmimic: npz for training, with MuJoCo's or
            Isaac Lab's order of joints; gmr: npz with GMR's arrays.
        out: file to write.
        fps: frames per second; by default 30 for csv, 50 for mjlab and beyondmimic.
    """
    from openclone.motion.clip import load_clip
    from openclone.motion.exports import export

    positive("--fps", fps)
    written = export(load_clip(clip), format, out, fps)
    print(f"{out}: {written.num_frames} frames at {written.info.fps:g} Hz")


def motions_import(
    source: Path,
    /,
    *,
    out: Path,
    category: str = "transition",
    licence: str = "unknown",
    fps: float | None = None,
) -> None:
    """Make a clip of a G1 motion in another project's format.

    Human recordings need `openclone motions retarget` instead.

    Args:
        source: G1 .csv, or .npz of mjlab, BeyondMimic or GMR.
        out: clip file to write (.npz).
        category: what the motion shows.
        licence: licence and credit of the motion.
        fps: frames per second of a .csv, which does not say; by default 30.
    """
    from dataclasses import replace

    from openclone.motion.clip import Clip, save_clip
    from openclone.motion.readers import read_motion
    from openclone.motion.sources import g1_csv

    positive("--fps", fps)
    table = source.suffix.lower() == ".csv"
    if fps and not table:
        raise InputError("--fps is for .csv", remedy="leave it out: the file says it")
    motion = g1_csv.read(source, fps) if fps else read_motion(source)
    if not isinstance(motion, Clip):
        raise InputError(
            "this is a human recording",
            where=str(source),
            remedy="use `openclone motions retarget`",
        )
    info = replace(motion.info, category=category, licence=licence)
    save_clip(replace(motion, info=info), out)
    print(f"{out}: {motion.num_frames} frames at {motion.info.fps:g} Hz")
