"""Which motions a run learns from."""

from __future__ import annotations

import math
from dataclasses import dataclass

from openclone.errors import InputError
from openclone.motion.clip import Clip
from openclone.motion.commands import is_command
from openclone.training.data import is_recorded, select_clips
from openclone.training.held_back import held_back_clips


@dataclass(frozen=True)
class DataChoice:
    """Which clips a run learns from.

    Attributes:
        categories: motion categories to train on; None for all.
        recorded_only: leave out synthetic and edited clips.
        commands: also train on what no feet can follow: gliding laps, and recordings
            as a governor passes them on (`held_back`).
        mirror: also train on every clip with left and right swapped.
        still_seconds: hold clips that end at rest for this long. The same for teacher
            and student, which then share what is computed about the motions.
        fastest: metres per second; clips that travel faster for half a second are left
            out. 1.4 leaves out jogs, runs and side-steps at a run, and keeps walks.
    """

    categories: tuple[str, ...] | None = None
    recorded_only: bool = False
    commands: bool = True
    mirror: bool = True
    still_seconds: float = 4.0
    fastest: float = math.inf

    def select(self, clips: list[Clip]) -> list[Clip]:
        """The training motions among ``clips``, padded and mirrored.

        Raises:
            InputError: none is left.
        """
        kept = [
            clip
            for clip in clips
            if (is_recorded(clip) or not self.recorded_only)
            and (self.commands or not is_command(clip.info))
        ]
        if clips and not kept:
            raise InputError(
                "this preset trains on recordings alone, and there are none",
                remedy="give a folder of recordings with --motions",
            )
        if self.commands and not self.recorded_only:
            kept += held_back_clips(kept)
        return select_clips(
            kept, self.categories, self.mirror, self.still_seconds, self.fastest
        )
