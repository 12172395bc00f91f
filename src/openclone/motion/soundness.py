"""Whether an edited motion may stand beside the original, or why it is refused."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from openclone.motion.clip import Clip
from openclone.motion.planted import EditRefused, feet_of
from openclone.motion.quality import ClipQuality, Gate, QualityMeter, faults
from openclone.motion.sources.whole_body import zero_moment_point
from openclone.robot import g1

_TOUCH = 0.01
"""Metres above the ground below which a sole's corner carries load."""


_KINDS = {
    "beyond its limit": "joint limit",
    "slide": "sliding feet",
    "under the ground": "parts underground",
    "inside each other": "parts inside each other",
    "motor's speed": "too fast",
    "jerk": "jerks",
    "float": "floats",
    "off the ground": "off the ground",
    "flips": "flips",
    "fall": "would fall",
    "": "too short",
}
"""The kind of a fault, by words of its description; the first that fits."""


@dataclass(frozen=True)
class Tolerance:
    """What an edit may cost, compared with the clips that it was made from.

    Attributes:
        slide_cm_s: the least that standing feet may always slide, cm/s.
        share: how much the shares of bad frames may grow.
        limit_rad: how far a joint may be beyond its limit, radians.
        off_balance: how much the share of frames may grow in which the zero-moment
            point is further than `balance_margin` outside the soles.
        balance_margin: metres.
    """

    slide_cm_s: float = 3.0
    share: float = 0.01
    limit_rad: float = 1e-3
    off_balance: float = 0.1
    balance_margin: float = 0.04


@cache
def _meter() -> QualityMeter:
    return QualityMeter()


def quality_of(clip: Clip) -> ClipQuality:
    """Figures of ``clip``, see `ClipQuality`."""
    return _meter().measure(clip.qpos, clip.info.fps)


def outside_soles(clip: Clip) -> np.ndarray:
    """(T,) metres of the zero-moment point outside the soles on the ground.

    Negative inside; NaN where nothing stands or hardly any weight is carried.
    """
    points = zero_moment_point(clip.qpos, clip.info.fps)
    corners = feet_of(clip.qpos).corners().reshape(clip.num_frames, 8, 3)
    result = np.full(clip.num_frames, np.nan)
    for frame in range(clip.num_frames):
        touching = corners[frame, corners[frame, :, 2] < _TOUCH, :2]
        if len(touching) < 3 or not np.isfinite(points[frame]).all():
            continue
        try:
            sides = ConvexHull(touching).equations
        except QhullError:
            continue
        result[frame] = (sides[:, :2] @ points[frame] + sides[:, 2]).max()
    return result


def off_balance_share(clip: Clip, margin: float) -> float:
    """Share of standing frames whose zero-moment point is ``margin`` outside."""
    outside = outside_soles(clip)
    known = np.isfinite(outside)
    return float((outside[known] > margin).mean()) if known.any() else 0.0


def _limit_fault(clip: Clip, tolerance: float) -> str:
    angles = clip.joint_angles
    outside = np.maximum(g1.JOINT_LOWER - angles, angles - g1.JOINT_UPPER)
    frame, joint = np.unravel_index(int(np.argmax(outside)), outside.shape)
    if outside[frame, joint] <= tolerance:
        return ""
    name, excess = g1.JOINT_NAMES[joint], outside[frame, joint]
    return f"{name} is {excess:.3f} rad beyond its limit in frame {frame}"


def check_edit(
    clip: Clip, sources: tuple[Clip, ...], tolerance: Tolerance | None = None
) -> ClipQuality:
    """Figures of an edited ``clip`` that is about as clean as its ``sources``.

    Raises:
        EditRefused: joints leave their limits or outrun their motors, feet slide,
            parts touch, or the balance is lost; names the reason.
    """
    tolerance = tolerance or Tolerance()
    before = [quality_of(source) for source in sources]
    slide = max((item.slide_cm_s for item in before), default=0.0)
    gate = Gate(
        slide_cm_s=max(tolerance.slide_cm_s, 1.2 * slide),
        ground_share=_allowed([item.ground_share for item in before], tolerance),
        self_share=_allowed([item.self_share for item in before], tolerance),
        spike_share=_allowed([item.spike_share for item in before], tolerance),
    )
    quality = quality_of(clip)
    reasons = list(faults(quality, gate))
    if fault := _limit_fault(clip, tolerance.limit_rad):
        reasons.insert(0, fault)
    margin = tolerance.balance_margin
    allowed = tolerance.off_balance + max(
        (off_balance_share(source, margin) for source in sources), default=0.0
    )
    share = off_balance_share(clip, margin)
    if share > allowed:
        reasons.append(
            f"it would fall: in {share:.0%} of the frames the zero-moment point is "
            f"{100 * margin:.0f} cm outside the soles (at most {allowed:.0%})"
        )
    if reasons:
        raise EditRefused(
            "; ".join(reasons),
            reason=next(kind for word, kind in _KINDS.items() if word in reasons[0]),
            where=clip.info.name,
            remedy="edit less, or choose another clip",
        )
    return quality


def _allowed(shares: list[float], tolerance: Tolerance) -> float:
    """The largest share of bad frames that an edit may have."""
    return max(shares, default=0.0) + tolerance.share
