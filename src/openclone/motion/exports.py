"""Motions of the G1 in the formats of other projects."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Literal

from openclone.errors import InputError
from openclone.motion.clip import Clip
from openclone.motion.sources import g1_csv, gmr_npz, mjlab_npz

Format = Literal["csv", "mjlab", "beyondmimic", "gmr"]
FPS: dict[str, float | None] = {
    "csv": g1_csv.FPS, "mjlab": 50.0, "beyondmimic": 50.0, "gmr": None,
}  # fmt: skip
"""Usual frame rates: mjlab and BeyondMimic play one frame per control step of 20 ms."""
_WRITERS: dict[str, Callable[[Clip, Path], None]] = {
    "csv": g1_csv.write,
    "mjlab": mjlab_npz.write,
    "beyondmimic": partial(mjlab_npz.write, isaac_order=True),
    "gmr": gmr_npz.write,
}


def export(clip: Clip, kind: Format, path: Path, fps: float | None = None) -> Clip:
    """Write ``clip`` in another project's format.

    Args:
        clip: the motion.
        kind: ``"csv"`` (Unitree's, mjlab's converter), ``"mjlab"`` and
            ``"beyondmimic"`` (npz for training, in MuJoCo's and Isaac Lab's order of
            joints), ``"gmr"`` (npz with GMR's arrays).
        path: the file.
        fps: frames per second; None for the format's usual rate.

    Returns:
        What was written, after resampling.

    Raises:
        InputError: the suffix does not belong to the format, or the rate is odd.
    """
    suffix = ".csv" if kind == "csv" else ".npz"
    if path.suffix.lower() != suffix:
        raise InputError(
            f"a file for {kind} ends in {suffix}",
            where=str(path),
            remedy=f"write to {path.with_suffix(suffix).name}",
        )
    rate = fps or FPS[kind] or clip.info.fps
    if not 1 <= rate <= 1000:
        raise InputError(f"{rate:g} frames per second", remedy="give 1 to 1000")
    if rate != clip.info.fps:
        clip = clip.resampled(rate)
    _WRITERS[kind](clip, path)
    return clip
