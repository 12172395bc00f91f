"""Checkpoints: everything needed to go on training, and nothing executable."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch

from openclone.errors import InputError


def save_checkpoint(path: Path, content: dict[str, Any]) -> None:
    """Write ``content`` (tensors, state dicts, plain values) in one piece."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".partial")
    torch.save(content, partial)
    partial.replace(path)


def load_checkpoint(path: Path) -> dict[str, Any]:
    """Read a checkpoint; refuses anything but tensors and plain values.

    Raises:
        InputError: the file is missing or not a checkpoint.
    """
    if not path.is_file():
        raise InputError(
            "no such checkpoint", where=str(path), remedy="train without --resume first"
        )
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises unrelated types on damaged files
        line = str(error).splitlines()[0]
        raise InputError(
            f"not a readable checkpoint ({line})",
            where=str(path),
            remedy="delete it and train again",
        ) from None
    if not isinstance(content, dict):
        raise InputError("not a checkpoint of OpenClone", where=str(path))
    return content
