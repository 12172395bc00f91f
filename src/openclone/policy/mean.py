"""The mean of several students' weights: often steadier than each of them.

Students that learned on from one another lie in one valley of the loss, and the mean of
their weights is a student too ("model soups", Wortsman et al. 2022).
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from openclone.errors import InputError
from openclone.policy.bundle import load_bundle, write_metadata

_ALIKE = (
    "layout",
    "history",
    "joint_names",
    "default_pose",
    "action_scale",
    "kp",
    "kd",
)


def mean_bundle(files: list[Path], shares: list[float], out: Path) -> None:
    """Write the mean of bundles, metadata included.

    Args:
        files: at least two bundles of one architecture.
        shares: of each in the mean, positive; divided by their sum.
        out: the new bundle.

    Raises:
        InputError: too few bundles, shares that are not theirs, or a bundle that is
            damaged or of another kind than the first.
    """
    import onnx
    from onnx import numpy_helper

    if len(files) < 2:
        raise InputError(
            "a mean needs two bundles or more", remedy="give --bundles A B"
        )
    if len(shares) != len(files) or not all(0 < s < math.inf for s in shares):
        raise InputError(
            f"{len(files)} bundles, but shares {shares}",
            remedy="give each bundle one positive share, or no shares at all",
        )
    infos = [load_bundle(file).info for file in files]
    models = [onnx.load(str(file)) for file in files]
    tables = [
        {item.name: numpy_helper.to_array(item) for item in model.graph.initializer}
        for model in models
    ]
    shapes = [{name: (a.shape, a.dtype) for name, a in t.items()} for t in tables]
    for file, info, found in zip(files, infos, shapes, strict=True):
        same = all(getattr(info, name) == getattr(infos[0], name) for name in _ALIKE)
        if found != shapes[0] or not same:
            raise InputError(
                f"not of the same kind as {files[0]}",
                where=str(file),
                remedy="take bundles of one run, or of runs that started from another",
            )
    parts = np.array(shares) / sum(shares)
    for item in models[0].graph.initializer:
        first = tables[0][item.name]
        if first.dtype.kind == "f":
            stack = [table[item.name].astype(np.float64) for table in tables]
            mean = np.tensordot(parts, stack, 1).astype(first.dtype)
            item.CopyFrom(numpy_helper.from_array(mean, item.name))
    out.parent.mkdir(parents=True, exist_ok=True)
    onnx.save(models[0], str(out))
    sources = "; ".join(
        f"{part:.2f} x ({info.training})"
        for part, info in zip(parts, infos, strict=True)
    )
    write_metadata(out, replace(infos[0], training=f"mean of {sources}"))
