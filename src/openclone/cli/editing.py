"""Commands that make new motions from old ones: motions edit, motions augment."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from openclone.cli.motions import file_name
from openclone.cli.options import positive, print_figures, write_figures
from openclone.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from openclone.motion.clip import Clip


def motions_edit(
    clip: Path,
    /,
    *,
    out: Path,
    upper: Path | None = None,
    head_height: float | None = None,
    fig3: bool = False,
    rate: float | None = None,
    reverse: bool = False,
    mirror: bool = False,
    then: Path | None = None,
    pad: float = 0.0,
) -> None:
    """Edit a clip; the steps are taken in the order of the options below.

    An edit that would slide the feet, leave the limits of joints or motors, push parts
    into each other, or tip the robot over is refused, with the reason.

    Args:
        clip: the clip file.
        out: folder for the result.
        upper: clip whose waist and arms replace those of the first.
        head_height: metres above the ground, 1.2 (standing) to 0.6 (deep squat).
        fig3: seven clips, with the head at 1.2, 1.1 ... 0.6 m, instead of one.
        rate: play at this rate; above 1 is faster.
        reverse: play backwards.
        mirror: swap left and right.
        then: clip that follows without a seam.
        pad: seconds of standing before and after.
    """
    from openclone.motion import edit, recombine, warp
    from openclone.motion.blend import joined
    from openclone.motion.clip import load_clip
    from openclone.motion.heights import height_series, with_head_height

    positive("--rate", rate)
    positive("--head-height", head_height)
    if pad < 0:
        raise InputError(f"--pad is {pad:g}", remedy="give seconds, 0 or more")
    result = load_clip(clip)
    if upper is not None:
        result = recombine.recombined(result, load_clip(upper))
    if head_height is not None:
        result = with_head_height(result, head_height)
    if rate is not None:
        result = warp.time_warped(result, rate)
    if reverse:
        result = warp.time_reversed(result)
    if mirror:
        result = edit.mirror(result)
    if then is not None:
        result = joined(result, load_clip(then))
    if pad > 0:
        result = edit.pad_start(edit.pad_still(result, pad), pad)
    results, refusals = height_series(result) if fig3 else ([result], [])
    _write(results, refusals, out)


def _write(results: list[Clip], refusals: list[str], out: Path) -> None:
    """Save the edited clips and say which edits were refused."""
    from openclone.motion.clip import save_clip

    for made in results:
        save_clip(made, out / file_name(made))
        print(f"{out / file_name(made)}: {made.seconds:.1f} s")
    for refusal in refusals:
        print(f"refused {refusal}")


def motions_augment(
    source: Path,
    /,
    *,
    out: Path,
    split: str = "train",
    hands: int = 1,
    pairs: int = 1,
    rates: int = 1,
    seed: int = 0,
    json: Path | None = None,
) -> None:
    """Make more motions of a folder: varied hands, new pairings, other timings.

    Args:
        source: folder of clips or recordings.
        out: folder for the new clips; the old ones are not copied.
        split: part of the source that is used.
        hands: copies of each clip whose hands turn over the whole range of the wrist.
        pairs: copies of each clip with waist and arms of another one.
        rates: copies of each clip that are played at an uneven rate.
        seed: equal seeds give equal motions.
        json: write the figures, refusals by reason among them, to this file.
    """
    import numpy as np

    from openclone.cli.options import load_clips
    from openclone.motion.clip import save_clip
    from openclone.motion.coverage import hand_coverage

    for option, value in (("hands", hands), ("pairs", pairs), ("rates", rates)):
        if value < 0:
            raise InputError(f"--{option} is {value}", remedy="give 0 or more")
    clips = load_clips((source,), split, "", apart=split == "train")
    made: list[Clip] = []
    refused: dict[str, int] = {}
    for number, clip in enumerate(clips):
        rng = np.random.default_rng([seed, number])
        plan = {"hands": hands, "pairs": pairs, "rates": rates}
        for kind, count in plan.items():
            for copy in range(count):
                result = _augmented(kind, clip, clips, rng, copy, refused)
                if result is not None:
                    save_clip(result, out / file_name(result))
                    made.append(result)
        print(f"[{number + 1}/{len(clips)}] {clip.info.name}", flush=True)
    if not made:
        raise InputError("every edit was refused", remedy="choose other clips")
    figures: dict[str, object] = {
        "clips": len(made),
        "minutes": sum(clip.seconds for clip in made) / 60,
    }
    figures |= {f"refused {reason}": count for reason, count in refused.items()}
    varied = [clip for clip in made if "~hands" in clip.info.name] or made
    for label, group in (("before", clips), ("after", varied)):
        coverage = hand_coverage(group).figures()
        figures |= {f"{label} {name}": value for name, value in coverage.items()}
    print_figures(figures)
    write_figures(json, figures)


def _augmented(
    kind: str,
    clip: Clip,
    clips: list[Clip],
    rng: np.random.Generator,
    copy: int,
    refused: dict[str, int],
) -> Clip | None:
    """One edit of ``clip``; None, and a count in ``refused``, if it is refused."""
    from dataclasses import replace

    from openclone.motion.hands import with_varied_hands
    from openclone.motion.planted import EditRefused
    from openclone.motion.recombine import recombined
    from openclone.motion.warp import random_rates, time_warped

    try:
        if kind == "hands":
            result = with_varied_hands(clip, rng)
        elif kind == "pairs":
            result = recombined(clip, clips[int(rng.integers(len(clips)))])
        else:
            rates = random_rates(rng, clip.seconds, 0.25, clip.info.fps)
            result = time_warped(clip, rates[: clip.num_frames])
    except EditRefused as refusal:
        reason = refusal.reason
        refused[f"{kind}: {reason}"] = refused.get(f"{kind}: {reason}", 0) + 1
        return None
    name = f"{result.info.name}{copy}" if copy else result.info.name
    return replace(result, info=replace(result.info, name=name))
