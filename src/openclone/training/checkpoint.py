"""Checkpoints: everything needed to go on training, and nothing executable."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch

from openclone.errors import InputError
from openclone.training.progress import Trained


def save_checkpoint(path: Path, content: dict[str, Any]) -> None:
    """Write ``content`` (tensors, state dicts, plain values) in one piece."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".partial")
    torch.save(_on_cpu(content), partial)
    partial.replace(path)


def _on_cpu(value: Any) -> Any:
    """``value`` with all its tensors on the CPU, readable on every machine."""
    if isinstance(value, torch.Tensor):
        return value.detach().cpu()
    if isinstance(value, dict):
        return {key: _on_cpu(part) for key, part in value.items()}
    if isinstance(value, (list, tuple)):
        return type(value)(_on_cpu(part) for part in value)
    return value


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


def trained_so_far(content: dict[str, Any]) -> Trained:
    """Counters of a checkpoint; iterations were not kept in the oldest ones."""
    return Trained(content["steps"], content["minutes"], content.get("iterations", 0))


@contextmanager
def fitting(path: Path) -> Iterator[None]:
    """Turn what torch raises on state that does not fit into one line.

    Raises:
        InputError: the checkpoint lacks a part, or was made for other networks.
    """
    try:
        yield
    except KeyError as error:
        raise InputError(
            f"the checkpoint has no {error.args[0]!r}",
            where=str(path),
            remedy="is it a teacher's where a student's is wanted, or the reverse?",
        ) from None
    except (RuntimeError, ValueError) as error:
        lines = [line.strip() for line in str(error).splitlines()] or ["unknown"]
        raise InputError(
            f"the checkpoint does not fit the preset's networks ({lines[-1]})",
            where=str(path),
            remedy="use the preset it was trained with",
        ) from None
