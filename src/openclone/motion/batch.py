"""Retargeting many recordings: over several processes, and never the same one twice.

Every finished recording leaves its clip and its figures in a cache, named by the
content of the recording and the version of the method. Work that was interrupted goes
on where it stopped; results do not depend on the number of processes.
"""

from __future__ import annotations

import functools
import hashlib
import json
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from openclone.errors import InputError, OpenCloneError
from openclone.motion.clip import Clip, ClipInfo, load_clip, save_clip
from openclone.motion.quality import MEASURE_VERSION, ClipQuality, QualityMeter
from openclone.motion.workers import worker_pool

if TYPE_CHECKING:
    from openclone.motion.retarget import Solver

_WORTHWHILE = 4
"""Recordings per process below which starting one takes longer than it saves."""


@dataclass(frozen=True)
class Job:
    """One recording, or one ready clip, to be made into a measured clip.

    Attributes:
        info: what the clip will say about itself.
        path: the recording or clip file.
        result: where clip (``.npz``) and figures (``.json``) are kept; no suffix.
        ready: ``path`` is a clip already and only needs measuring.
        slower: the recording is played so many times longer before it is retargeted.
        head_m: ``path`` is a clip that is to go down until its head is so high.
    """

    info: ClipInfo
    path: Path
    result: Path
    ready: bool = False
    slower: float = 1.0
    head_m: float | None = None


@dataclass(frozen=True)
class Outcome:
    """What became of a job.

    Attributes:
        job: the job.
        quality: the clip's figures; None if there is no clip.
        error: why there is none, else empty.
        fresh: it was made now, not found in the cache.
    """

    job: Job
    quality: ClipQuality | None
    error: str = ""
    fresh: bool = True

    @property
    def clip_path(self) -> Path:
        """Where the clip is."""
        return self.job.path if self.job.ready else self.job.result.with_suffix(".npz")


def available_workers() -> int:
    """Processor cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1


def digest_of(files: Sequence[Path], salt: str) -> str:
    """Name for what is made of ``files``: their content and ``salt``, hashed.

    Raises:
        InputError: a file is missing.
    """
    digest = hashlib.sha256(f"{salt}\n".encode())
    for file in files:
        if not file.is_file():
            raise InputError(
                "no such file", where=str(file), remedy="correct the manifest"
            )
        digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()[:32]


def run_jobs(
    jobs: Sequence[Job],
    workers: int,
    done: Callable[[Outcome], None] = lambda outcome: None,
) -> list[Outcome]:
    """Outcomes of ``jobs``, in their order.

    Scripts that ask for several workers need the usual ``if __name__ == "__main__":``.

    Args:
        jobs: what to do.
        workers: processes, at most; few jobs are done by this process itself.
        done: is told of every outcome as soon as it is there.

    Raises:
        OpenCloneError: a process died, e.g. for want of memory.
    """
    outcomes: dict[int, Outcome] = {}
    missing: list[int] = []
    for index, job in enumerate(jobs):
        found = _recall(job)
        if found is None:
            missing.append(index)
        else:
            outcomes[index] = found
            done(found)
    workers = min(workers, len(missing) // _WORTHWHILE)
    if workers < 2:
        for index in missing:
            outcomes[index] = work(jobs[index])
            done(outcomes[index])
    else:
        # The longest first: none is left over while the other processes idle.
        missing.sort(key=lambda index: -jobs[index].path.stat().st_size)
        for index, outcome in _spread([(i, jobs[i]) for i in missing], workers):
            outcomes[index] = outcome
            done(outcome)
    return [outcomes[index] for index in range(len(jobs))]


def _spread(todo: list[tuple[int, Job]], workers: int) -> Iterator[tuple[int, Outcome]]:
    try:
        with worker_pool(workers) as pool:
            futures = {pool.submit(work, job): index for index, job in todo}
            for future in as_completed(futures):
                yield futures[future], future.result()
    except BrokenProcessPool:
        raise OpenCloneError(
            "a process that retargets died, perhaps for want of memory; "
            "run the command again, with fewer workers: finished work is kept"
        ) from None


@functools.cache
def _solver() -> Solver:
    """This process's solver."""
    from openclone.motion.retarget import Solver

    return Solver()


@functools.cache
def _meter() -> QualityMeter:
    return QualityMeter()


def measure_clip(clip: Clip) -> ClipQuality:
    """Figures of a clip whose targets are unknown."""
    return _meter().measure(clip.qpos, clip.info.fps)


def work(job: Job) -> Outcome:
    """Do one job in this process."""
    try:
        clip, quality = _made(job)
        if not job.ready:
            save_clip(clip, job.result.with_suffix(".npz"))
    except InputError as error:
        # A refused edit names the motion, as whoever reports it will do.
        return Outcome(job, None, str(error).removeprefix(f"{job.info.name}: "))
    except (ArithmeticError, ValueError) as error:
        # One odd recording must not end the build of a thousand.
        return Outcome(job, None, f"{job.path}: cannot be retargeted ({error})")
    _remember(job, quality)
    return Outcome(job, quality)


def _made(job: Job) -> tuple[Clip, ClipQuality]:
    """The clip of a job and its figures."""
    from openclone.motion.heights import gone_down
    from openclone.motion.readers import read_motion
    from openclone.motion.retarget import follow

    if job.ready or job.head_m is not None:
        clip = load_clip(job.path)
        if job.head_m is not None:
            clip = gone_down(clip, job.head_m)
        return clip, measure_clip(clip)
    motion = read_motion(job.path)
    if not isinstance(motion, Clip):
        slowed = replace(motion, fps=motion.fps / job.slower)
        return follow(slowed, job.info, _solver())
    if job.slower != 1.0:
        raise InputError("the robot's own motion is balanced at its own pace only")
    # The G1's already, in a foreign format.
    clip = replace(motion.resampled(job.info.fps), info=job.info)
    return clip, measure_clip(clip)


def _remember(job: Job, quality: ClipQuality) -> None:
    """Write the figures last: with them the result is complete."""
    path = job.result.with_suffix(".json")
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(f".{os.getpid()}.partial")
    figures = {"version": MEASURE_VERSION, **asdict(quality)}
    partial.write_text(json.dumps(figures), encoding="utf-8")
    partial.replace(path)


def _recall(job: Job) -> Outcome | None:
    """The outcome of an earlier run; None if there is none or it is damaged."""
    path = job.result.with_suffix(".json")
    if not path.is_file():
        return None
    try:
        figures = json.loads(path.read_text(encoding="utf-8"))
        if figures.pop("version") != MEASURE_VERSION:
            return None
        quality = ClipQuality(**figures)
        if not job.ready:
            load_clip(job.result.with_suffix(".npz"))
    except (InputError, OSError, ValueError, TypeError, KeyError):
        return None
    return Outcome(job, quality, fresh=False)
