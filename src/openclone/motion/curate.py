"""Curation: from folders of recordings to a data set with nothing bad in it.

The data set is a folder: ``<split>/*.npz``, a ``manifest.tsv`` that
`library.load_clips` reads, ``rejects.tsv`` with the reason for each motion that was
turned away, and ``build.json`` with the settings.
"""

from __future__ import annotations

import csv
import hashlib
import json
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

from openclone.errors import InputError
from openclone.motion import library, splits
from openclone.motion.batch import Job, Outcome, available_workers, run_jobs
from openclone.motion.clip import ClipInfo, clip_hash, load_clip, save_clip
from openclone.motion.commands import gate_for
from openclone.motion.discover import Recording, discover
from openclone.motion.enrich import Enrichment
from openclone.motion.quality import ClipQuality, Gate, faults
from openclone.motion.retarget import VERSION

BUILD_FILE, REJECTS = "build.json", "rejects.tsv"
EXTRA_COLUMNS = ("source", "performance", "sha256", *ClipQuality.columns())
"""Columns of the manifest after those that every manifest has."""


@dataclass(frozen=True)
class BuildConfig:
    """Settings of a build.

    Attributes:
        seed: chooses the performances that are held out.
        dev_share: share of each category's time that is held out.
        resplit: choose for all, not only for motions without a split in a manifest.
        gate: what a clip must reach.
        enrichment: what is made of the training clips and added to them; None: nothing.
    """

    seed: int = 0
    dev_share: float = 0.15
    resplit: bool = False
    gate: Gate = field(default_factory=Gate)
    enrichment: Enrichment | None = None


@dataclass(frozen=True)
class BuiltClip:
    """One clip of the data set.

    Attributes:
        info: name, category, source, licence.
        split: train or dev, or as the source says.
        path: relative to the data set.
        performance: what it is a take of.
        sha256: of the clip file.
        quality: its figures.
    """

    info: ClipInfo
    split: str
    path: str
    performance: str
    sha256: str
    quality: ClipQuality


@dataclass(frozen=True)
class Reject:
    """A motion that is not in the data set, and why.

    Attributes:
        info: name, category, source, licence.
        reasons: at least one.
        quality: its figures; None if it could not be read.
    """

    info: ClipInfo
    reasons: tuple[str, ...]
    quality: ClipQuality | None


@dataclass(frozen=True)
class Build:
    """What a build made.

    Attributes:
        clips, rejects: what is in the data set, and what is not.
        config: settings.
        digest: names the motions, however they are stored.
        moved: clips that are not in the split that their manifest gives them.
    """

    clips: tuple[BuiltClip, ...]
    rejects: tuple[Reject, ...]
    config: BuildConfig
    digest: str
    moved: tuple[splits.Moved, ...] = ()

    @property
    def seconds(self) -> float:
        """Duration of all clips."""
        return sum(clip.quality.seconds for clip in self.clips)


def build(
    sources: Sequence[Path],
    out: Path,
    config: BuildConfig | None = None,
    *,
    cache: Path | None = None,
    workers: int | None = None,
    progress: Callable[[int, int, Outcome], None] = lambda done, total, outcome: None,
    category: str = "",
    licence: str = "unknown",
) -> Build:
    """Make a data set of the recordings and clips in ``sources``.

    Args:
        sources: recordings, clips, or folders of them, with or without a manifest.
        out: the data set's folder; an earlier build in it is replaced.
        config: settings.
        cache: folder that keeps finished work; None for the user's.
        workers: processes; None for one per core. The result does not depend on it.
        progress: receives the number of motions done and to do, and each outcome.
        category: of motions outside any manifest; empty to judge by their names.
        licence: of motions outside any manifest.

    Raises:
        InputError: a source does not exist or a manifest is malformed.
    """
    config = config or BuildConfig()
    cache = cache or library.default_cache()
    found = discover(sources, category, licence)
    jobs, rejects = _jobs(found, cache)
    workers = workers or available_workers()
    accepted, refused = _sorted_out(jobs, config.gate, workers, progress)
    recordings = {recording.name: recording for recording in found}
    sides, moved = _sides(accepted, recordings, config)
    performances = {name: item.performance for name, item in recordings.items()}
    if config.enrichment is not None:
        training = [o for o in accepted if sides[o.job.info.name] == splits.TRAIN]
        jobs = config.enrichment.jobs(training)
        added, unfit = _sorted_out(jobs, config.gate, workers, progress)
        for outcome in added:
            name = outcome.job.info.name
            sides[name] = splits.TRAIN
            performances[name] = performances[name.rpartition("~")[0]]
        accepted, refused = [*accepted, *added], [*refused, *unfit]
    clips, digest = _store(accepted, performances, sides, out)
    rejects = sorted([*rejects, *refused], key=lambda reject: reject.info.name)
    made = Build(clips, tuple(rejects), config, digest, moved)
    _write_tables(made, out, sources)
    return made


def _sorted_out(
    jobs: Sequence[Job],
    gate: Gate,
    workers: int,
    progress: Callable[[int, int, Outcome], None],
) -> tuple[list[Outcome], list[Reject]]:
    """Do ``jobs``: what passes the gate, and what does not."""
    count = 0

    def tell(outcome: Outcome) -> None:
        nonlocal count
        count += 1
        progress(count, len(jobs), outcome)

    accepted: list[Outcome] = []
    rejects: list[Reject] = []
    for outcome in run_jobs(jobs, workers, tell):
        info, reasons = outcome.job.info, (outcome.error,)
        if outcome.quality is not None:
            reasons = faults(outcome.quality, gate_for(info, gate))
        if reasons:
            rejects.append(Reject(info, reasons, outcome.quality))
        else:
            accepted.append(outcome)
    return accepted, rejects


def _jobs(found: list[Recording], cache: Path) -> tuple[list[Job], list[Reject]]:
    """Work to be done; missing files and copies are turned away at once."""
    jobs: list[Job] = []
    rejects: list[Reject] = []
    seen: dict[Path, str] = {}
    for recording in found:
        info = recording.info
        try:
            job = library.job_of(recording.entry, cache)
        except InputError as error:
            rejects.append(Reject(info, (str(error),), None))
            continue
        first = seen.setdefault(job.result, recording.name)
        if first != recording.name:
            rejects.append(Reject(info, (f"the same recording as {first}",), None))
            continue
        jobs.append(replace(job, info=info))
    return jobs, rejects


def _sides(
    accepted: list[Outcome], recordings: dict[str, Recording], config: BuildConfig
) -> tuple[dict[str, str], tuple[splits.Moved, ...]]:
    """Name -> split of all accepted motions, and those that were given another.

    Nothing synthesized is held out: there is more of it for the asking.
    """
    takes = []
    for outcome in accepted:
        recording = recordings[outcome.job.info.name]
        given = "" if config.resplit else recording.entry.split
        if not recording.info.recorded:
            given = given or splits.TRAIN
        takes.append(
            splits.Take(
                recording.name,
                recording.performance,
                recording.info.category,
                outcome.quality.seconds if outcome.quality else 0.0,
                given,
            )
        )
    return splits.settle(takes, config.seed, config.dev_share)


def _store(
    accepted: list[Outcome],
    performances: dict[str, str],
    sides: dict[str, str],
    out: Path,
) -> tuple[tuple[BuiltClip, ...], str]:
    """Write the clips into their splits; also returns the hash of their motions."""
    _remove_earlier(out)
    built, motions = [], []
    for outcome in accepted:
        clip = load_clip(outcome.clip_path)
        given = outcome.job.info
        if outcome.job.head_m is not None:
            given = replace(given, category=clip.info.category)
        clip = replace(clip, info=replace(given, fps=clip.info.fps))
        split = sides[given.name]
        relative = f"{split}/{given.name.replace('/', '__')}.npz"
        save_clip(clip, out / relative)
        sha256 = hashlib.sha256((out / relative).read_bytes()).hexdigest()
        assert outcome.quality is not None
        motions.append(clip)
        performance = performances[given.name]
        built.append(
            BuiltClip(clip.info, split, relative, performance, sha256, outcome.quality)
        )
    return tuple(sorted(built, key=lambda item: item.path)), clip_hash(motions)


def _remove_earlier(out: Path) -> None:
    """Delete the clips of an earlier build in ``out``, and nothing else."""
    if not (out / BUILD_FILE).is_file() or not (out / library.MANIFEST).is_file():
        return
    for entry in library.read_manifest(out):
        entry.path.unlink(missing_ok=True)


def _write_tables(made: Build, out: Path, sources: Sequence[Path]) -> None:
    out.mkdir(parents=True, exist_ok=True)
    rows = [
        (
            clip.split, clip.info.category, clip.path, "clip",
            f"{clip.quality.seconds:.2f}", clip.info.licence, clip.info.source,
            clip.performance, clip.sha256, *clip.quality.cells(),
        )
        for clip in made.clips
    ]  # fmt: skip
    _write_tsv(out / library.MANIFEST, (*library.COLUMNS, *EXTRA_COLUMNS), rows)
    refused = []
    for reject in made.rejects:
        about = reject.info
        cells = (about.name, about.category, about.source, about.licence)
        refused.append((*cells, "; ".join(reject.reasons)))
    head = ("name", "category", "source", "licence", "reason")
    _write_tsv(out / REJECTS, head, refused)
    settings = {
        "method": VERSION,
        "motions": made.digest,
        "clips": len(made.clips),
        "rejects": len(made.rejects),
        "seconds": round(made.seconds, 2),
        "config": asdict(made.config),
        "moved": [asdict(item) for item in made.moved],
        "sources": [os.path.relpath(source, out) for source in sources],
    }
    text = json.dumps(settings, indent=2, allow_nan=False) + "\n"
    (out / BUILD_FILE).write_text(text, encoding="utf-8")


def _write_tsv(path: Path, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(
            stream, delimiter="\t", quoting=csv.QUOTE_NONE, escapechar="\\",
            lineterminator="\n",
        )  # fmt: skip
        writer.writerow(head)
        writer.writerows([cell.replace("\t", " ") for cell in row] for row in rows)
