"""What a data set for training gains from its own clips: slower turns, lowered stands.

The robot's hips and ankles are slower and its feet are longer than a human's, so
recorded turns are hard for it; the same turn at a slower pace shows how it is done. Few
people squat in recordings; standing and gesturing clips are brought down instead.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from openclone.motion import heights
from openclone.motion.batch import Job, Outcome

_SLOWER = re.compile(r"~slow(\d+(?:\.\d+)?)")


@dataclass(frozen=True)
class Enrichment:
    """What is added to the split train.

    Attributes:
        slower: factors on the duration of recordings. They are slowed before they are
            retargeted, so that the clip is balanced at its own pace.
        slowed: categories that are slowed.
        heads_m: metres of the head above the ground that clips go down to.
        lowered: categories that are lowered.
        shortest_s, longest_s: clips of other lengths are not lowered, seconds.
    """

    slower: tuple[float, ...] = (1.2, 1.45)
    slowed: tuple[str, ...] = ("turn", "stepside")
    heads_m: tuple[float, ...] = (0.65, 0.75, 0.85, 0.95)
    lowered: tuple[str, ...] = ("stand", "wave")
    shortest_s: float = 3.0
    longest_s: float = 30.0

    def jobs(self, training: Sequence[Outcome]) -> list[Job]:
        """What to make of the accepted motions ``training``."""
        return [
            job
            for outcome in training
            for job in (*self._slowed(outcome), *self._lowered(outcome))
        ]

    def _slowed(self, outcome: Outcome) -> list[Job]:
        job = outcome.job
        # A clip without its recording has no targets to retarget to again.
        if job.ready or job.info.category not in self.slowed:
            return []
        return [
            replace(
                job,
                info=replace(job.info, name=f"{job.info.name}~slow{factor:g}"),
                result=_beside(job.result, f"slow{round(1000 * factor)}"),
                slower=factor,
            )
            for factor in self.slower
        ]

    def _lowered(self, outcome: Outcome) -> list[Job]:
        job, quality = outcome.job, outcome.quality
        if job.info.category not in self.lowered or quality is None:
            return []
        if not self.shortest_s <= quality.seconds <= self.longest_s:
            return []
        version = heights.VERSION
        return [
            replace(
                job,
                info=replace(job.info, name=heights.lowered_name(job.info.name, head)),
                path=outcome.clip_path,
                result=_beside(job.result, f"head{round(1000 * head)}-{version}"),
                ready=False,
                head_m=head,
            )
            for head in self.heads_m
        ]


def _beside(result: Path, mark: str) -> Path:
    """Where the cache keeps what is made of ``result``; no suffix."""
    return result.with_name(f"{result.name}-{mark}")


def slowness(name: str) -> float:
    """How many times longer than its recording the clip called ``name`` takes."""
    found = _SLOWER.search(name)
    return float(found[1]) if found else 1.0
