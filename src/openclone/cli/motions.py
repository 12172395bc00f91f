"""Commands that make motions: motions synthesize, motions retarget."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from openclone.cli.options import load_clips, positive, synthetic_clips

if TYPE_CHECKING:
    from openclone.motion.clip import Clip


def file_name(clip: Clip) -> str:
    """Name of a clip's file: the clip's name on one level."""
    return f"{clip.info.name.replace('/', '__')}.npz"


def motions_synthesize(*, out: Path, seed: int = 0, minutes: float = 10.0) -> None:
    """Make the default synthetic motions and write them as clip files.

    Args:
        out: folder for the clips.
        seed: equal seeds give equal motions.
        minutes: length of all motions together, roughly.
    """
    from openclone.motion.clip import save_clip

    positive("--minutes", minutes)
    clips = synthetic_clips(seed, minutes)
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
        source: recording (.bvh, .amc with its .asf beside it, DeepMimic .txt), or a
            folder with a manifest.tsv.
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
