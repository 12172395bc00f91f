"""Commands that curate motions: motions build, motions inspect."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from openclone.cli.options import positive, write_figures
from openclone.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from openclone.motion.batch import Outcome
    from openclone.motion.clip import Clip
    from openclone.motion.curate import Build
    from openclone.motion.quality import ClipQuality


def motions_build(
    sources: tuple[Path, ...],
    /,
    *,
    out: Path,
    seed: int = 0,
    dev_share: float = 0.15,
    resplit: bool = False,
    enrich: bool = False,
    workers: int | None = None,
    category: str = "",
    licence: str = "unknown",
    pictures: bool = True,
    json: Path | None = None,
) -> None:
    """Curate recordings into a data set: clips, manifest, splits, report.

    Clips that fail the quality gate are left out; OUT/rejects.tsv names the reasons.
    An interrupted build goes on where it stopped.

    Args:
        sources: recordings, clips, or folders of them, with or without a manifest.tsv.
        out: folder of the data set; an earlier build in it is replaced.
        seed: chooses the performances that are held out.
        dev_share: share of each category that is held out in the split dev.
        resplit: choose anew for all; by default the splits that a manifest gives are
            kept, except that a performance with a take held out is held out as a whole.
        enrich: add to the split train what training gains from: its turns and
            side-steps at a slower pace, its stands and gestures squatting.
        workers: processes; one per core by default. The result is the same.
        category: of recordings without a manifest; by default judged by their names.
        licence: of recordings without a manifest.
        pictures: render a contact sheet for the report.
        json: write the figures to this file.
    """
    from openclone.evaluation.motion_report import figures_of, write_motion_report
    from openclone.motion.curate import BuildConfig, build
    from openclone.motion.enrich import Enrichment

    positive("--workers", workers)
    if not 0 <= dev_share <= 0.5:
        raise InputError(f"--dev-share is {dev_share:g}", remedy="give 0 to 0.5")
    if not sources:
        raise InputError("no sources", remedy="name recordings or folders of them")
    more = Enrichment() if enrich else None
    config = BuildConfig(seed, dev_share, resplit, enrichment=more)
    with _progress_bar() as progress:
        made = build(
            sources, out, config, workers=workers, progress=progress,
            category=category, licence=licence,
        )  # fmt: skip
    _print_build(made, out)
    page, note = write_motion_report(made, out, pictures)
    if note:
        print(f"no contact sheet: {note}")
    print(f"report: {page}")
    write_figures(json, figures_of(made))


def _print_build(made: Build, out: Path) -> None:
    for reject in made.rejects:
        print(f"rejected {reject.info.name}: {'; '.join(reject.reasons)}")
    for moved in made.moved:
        print(f"moved {moved}")
    splits = sorted({clip.split for clip in made.clips})
    for split in splits:
        part = [clip for clip in made.clips if clip.split == split]
        minutes = sum(clip.quality.seconds for clip in part) / 60
        print(f"{split}: {len(part)} clips, {minutes:.1f} minutes")
    total = len(made.clips) + len(made.rejects)
    print(f"{len(made.clips)} of {total} motions accepted, in {out}")


@contextmanager
def _progress_bar() -> Iterator[Callable[[int, int, Outcome], None]]:
    """A bar on the terminal; silent where there is none."""
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, transient=True) as bar:
        task = bar.add_task("retargeting", total=None)

        def progress(done: int, total: int, outcome: Outcome) -> None:
            name = outcome.job.info.name.rpartition("/")[2]
            bar.update(task, completed=done, total=total, description=f"{name[:32]:32}")

        yield progress


def motions_inspect(
    clip: Path,
    /,
    *,
    recording: Path | None = None,
    view: bool = True,
    port: int | None = None,
    host: str | None = None,
) -> None:
    """Describe a clip and show it in the browser, the human beside the robot.

    Args:
        clip: clip file (.npz), or a human recording, which is retargeted first.
        recording: the human recording of the clip; found by itself in data sets made
            by `openclone motions build`.
        view: serve the browser view until Ctrl-C; --no-view only prints.
        port: of the view.
        host: address that serves the view; this machine only by default.
    """
    from openclone.motion.commands import gate_for
    from openclone.motion.quality import Gate, faults
    from openclone.motion.summary import summarize

    motion, quality, recording = _clip_at(clip, recording)
    print(summarize(motion))
    print(f"quality   {quality}")
    reasons = faults(quality, gate_for(motion.info, Gate()))
    print(f"gate      {'; '.join(reasons) or 'passed'}")
    if view:
        _show(motion, recording, port, host)


def _clip_at(
    path: Path, recording: Path | None
) -> tuple[Clip, ClipQuality, Path | None]:
    """The clip in a file, its figures and the human recording it was made of."""
    from openclone.motion.batch import measure_clip
    from openclone.motion.clip import ClipInfo, load_clip
    from openclone.motion.inspection import find_recording
    from openclone.motion.library import read_recording
    from openclone.motion.retarget import follow

    if path.suffix == ".npz":
        clip = load_clip(path)
        return clip, measure_clip(clip), recording or find_recording(clip, path)
    info = ClipInfo(path.stem, "transition", path.name, "unknown", 50.0)
    clip, quality = follow(read_recording(path), info)
    return clip, quality, path


def _show(
    clip: Clip, recording: Path | None, port: int | None, host: str | None
) -> None:
    """Serve the browser view until Ctrl-C."""
    from openclone.motion.inspection import BONES, human_beside
    from openclone.viewer.app import HOST, PORT
    from openclone.viewer.clip_view import ClipView

    human = None
    if recording is None:
        print("its human recording is unknown: name it with --recording")
    else:
        human = human_beside(clip, recording)
    title = f"**{clip.info.name}**\n\n{clip.info.category}, {clip.seconds:.1f} s"
    with ClipView(
        clip.qpos,
        clip.info.fps,
        title,
        human=human,
        bones=BONES,
        port=port or PORT,
        host=host or HOST,
    ) as view:
        print(f"open {view.url} in a browser; Ctrl-C ends", flush=True)
        view.play()
