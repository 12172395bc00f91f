"""Commands that make and describe motions: motions ..."""

from __future__ import annotations

from pathlib import Path

from openclone.cli.options import positive, synthetic_clips


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
        save_clip(clip, out / f"{clip.info.name.replace('/', '__')}.npz")
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
    """Turn a human recording into a clip of the G1.

    Args:
        source: recording (.bvh, .amc with its .asf beside it, DeepMimic .txt).
        out: folder for the clip.
        category: what the motion is, for metrics and presets.
        licence: licence and credit of the recording.
    """
    from openclone.motion.clip import ClipInfo, save_clip
    from openclone.motion.library import read_recording
    from openclone.motion.retarget import retarget

    motion = read_recording(source)
    info = ClipInfo(source.stem, category, source.name, licence, 50.0)
    clip, quality = retarget(motion, info)
    path = out / f"{source.stem}.npz"
    save_clip(clip, path)
    print(f"{path}: {clip.seconds:.1f} s, {quality}")


def motions_inspect(clip: Path, /) -> None:
    """Describe a clip file: length, path, heights, and what looks wrong.

    Args:
        clip: the .npz file.
    """
    from openclone.motion.clip import load_clip
    from openclone.motion.summary import summarize

    print(summarize(load_clip(clip)))
