"""What several commands share: checking options, loading clips, printing figures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from openclone.errors import InputError

if TYPE_CHECKING:
    from openclone.motion.clip import Clip


def positive(option: str, value: float | None) -> None:
    """Refuse a number that is not above zero; None passes."""
    if value is not None and not value > 0:
        raise InputError(f"{option} is {value:g}", remedy="give a number above 0")


def not_negative(option: str, value: float | None) -> None:
    """Refuse a number below zero; None passes."""
    if value is not None and not value >= 0:
        raise InputError(f"{option} is {value:g}", remedy="give a number from 0 on")


def category_names(text: str) -> tuple[str, ...] | None:
    """Split ``"a,b"``; None for an empty text, which means all categories."""
    return tuple(filter(None, text.replace(" ", "").split(","))) or None


def load_clips(
    folders: tuple[Path, ...], split: str, categories: str, *, apart: bool = False
) -> list[Clip]:
    """Clips of all ``folders``; recordings are retargeted and cached on the way.

    With ``apart``, takes of what the folder's manifest holds out are left out.
    """
    from openclone.motion import library
    from openclone.motion.batch import available_workers

    clips: list[Clip] = []
    for folder in folders:
        clips += library.load_clips(
            folder,
            split,
            category_names(categories),
            library.default_cache(),
            print,
            available_workers(),
            apart,
        )
    return clips


def synthetic_clips(seed: int, minutes: float, categories: str = "") -> list[Clip]:
    """The default synthetic motions, of the wanted categories."""
    from openclone.motion.clip import CATEGORIES
    from openclone.motion.sources.synthetic import default_set

    wanted = category_names(categories) or CATEGORIES
    for name in wanted:
        if name not in CATEGORIES:
            raise InputError(
                f"unknown category {name!r}", remedy="use " + ", ".join(CATEGORIES)
            )
    return [c for c in default_set(seed, minutes) if c.info.category in wanted]


def write_figures(path: Path | None, figures: dict[str, object]) -> None:
    """Write ``figures`` as JSON if a file was asked for."""
    if path is not None:
        from openclone.evaluation.report import write_json

        write_json(figures, path)


def print_figures(figures: dict[str, object]) -> None:
    """Print one line per figure."""
    for name, value in figures.items():
        text = f"{value:.2f}" if isinstance(value, float) else str(value)
        print(f"{name:14} {text}")
