"""The clip: one motion of the G1, and the file that carries it.

A clip file is the only thing that `motion` hands to `training` and `evaluation`.
It is a NumPy ``.npz`` without pickled objects: three float64 arrays and one JSON
string of metadata.
"""

from __future__ import annotations

import hashlib
import json
import zipfile
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from openclone.errors import InputError
from openclone.motion.npz import UNREADABLE, unpack
from openclone.robot import g1
from openclone.spatial import rotations

FORMAT = "openclone-clip-1"
MAX_FILE_BYTES = 256 * 1024 * 1024
MAX_FRAMES = 1_000_000
CATEGORIES = (
    "stand", "forward", "backward", "stepside", "turn", "squat", "crouchwalk",
    "jump", "punch", "wave", "reach", "pickup", "transition",
)  # fmt: skip
"""The paper's nine motion types (Fig. 4), then wave, reach, pickup, transition."""


@dataclass(frozen=True)
class ClipInfo:
    """Where a clip comes from.

    Attributes:
        name: unique within a data set, e.g. ``"accad/Female1_B03_Walk1"``.
        category: one of `CATEGORIES`.
        source: the recording or the generator and its seed.
        licence: the recording's licence and credit.
        fps: frames per second.
    """

    name: str
    category: str
    source: str
    licence: str
    fps: float

    @property
    def recorded(self) -> bool:
        """Whether it was made from a recording, edited or not, and not synthesized."""
        return not self.source.startswith("openclone")


@dataclass(frozen=True)
class Clip:
    """A G1 motion of T frames at a constant rate.

    Attributes:
        info: name, category, source, licence and frame rate.
        root_position: (T, 3), metres, world: origin of the pelvis.
        root_quat: (T, 4), wxyz, world from pelvis, sign-continuous.
        joint_angles: (T, 29), radians, Unitree motor order.
    """

    info: ClipInfo
    root_position: np.ndarray
    root_quat: np.ndarray
    joint_angles: np.ndarray

    @property
    def num_frames(self) -> int:
        """T."""
        return len(self.root_position)

    @property
    def seconds(self) -> float:
        """Duration from the first to the last frame."""
        return (self.num_frames - 1) / self.info.fps

    @property
    def qpos(self) -> np.ndarray:
        """(T, 36) MuJoCo generalized positions: position, quaternion, joints."""
        parts = (self.root_position, self.root_quat, self.joint_angles)
        return np.concatenate(parts, axis=1)

    def resampled(self, fps: float) -> Clip:
        """The same motion at another frame rate (linear, slerp for the root)."""
        count = int(np.floor(self.seconds * fps + 1e-9)) + 1
        at = np.arange(count) / fps * self.info.fps
        low = np.minimum(at.astype(int), max(self.num_frames - 2, 0))
        high = np.minimum(low + 1, self.num_frames - 1)
        part = at - low

        def blend(values: np.ndarray) -> np.ndarray:
            return values[low] * (1 - part[:, None]) + values[high] * part[:, None]

        quat = rotations.slerp(self.root_quat[low], self.root_quat[high], part)
        info = ClipInfo(**{**asdict(self.info), "fps": float(fps)})
        return Clip(
            info,
            blend(self.root_position),
            rotations.make_continuous(quat),
            blend(self.joint_angles),
        )


def clip_from_qpos(info: ClipInfo, qpos: np.ndarray) -> Clip:
    """Make a clip from MuJoCo positions ``(T, 36)``."""
    quat = rotations.make_continuous(rotations.normalize(qpos[:, 3:7]))
    return Clip(info, qpos[:, :3].copy(), quat, qpos[:, 7:].copy())


def check_clip(clip: Clip, where: str) -> Clip:
    """Return ``clip`` if well formed, else raise `InputError` naming ``where``."""
    count = len(np.atleast_1d(clip.root_position))
    shapes = {
        "root_position": (count, 3),
        "root_quat": (count, 4),
        "joint_angles": (count, g1.NUM_JOINTS),
    }
    if not 2 <= count <= MAX_FRAMES:
        raise InputError(
            f"a clip has 2 to {MAX_FRAMES} frames, this one {count}", where=where
        )
    for name, shape in shapes.items():
        values = getattr(clip, name)
        if values.shape != shape:
            raise InputError(
                f"{name} has shape {values.shape}, expected {shape}",
                where=where,
                remedy="write the clip with the 29 joints in Unitree motor order",
            )
        bad = np.argwhere(~np.isfinite(values))
        if len(bad):
            frame, column = bad[0]
            raise InputError(
                f"{name}[{frame}, {column}] is not a finite number",
                where=where,
                remedy="repair or drop this frame and write the clip again",
            )
    lengths = np.linalg.norm(clip.root_quat, axis=1)
    worst = int(np.argmax(np.abs(lengths - 1)))
    if abs(lengths[worst] - 1) > 1e-3:
        raise InputError(
            f"root_quat[{worst}] has length {lengths[worst]:.4f}, expected 1",
            where=where,
            remedy="normalize the quaternions (wxyz)",
        )
    if not 1 <= clip.info.fps <= 1000:
        raise InputError(f"fps is {clip.info.fps}, expected 1 to 1000", where=where)
    if clip.info.category not in CATEGORIES:
        raise InputError(
            f"unknown category {clip.info.category!r}",
            where=where,
            remedy="use one of " + ", ".join(CATEGORIES),
        )
    return clip


def save_clip(clip: Clip, path: Path) -> None:
    """Check and write ``clip``; an interrupted write leaves no half file behind."""
    check_clip(clip, str(path))
    path.parent.mkdir(parents=True, exist_ok=True)
    metadata = json.dumps({"format": FORMAT, **asdict(clip.info)})
    partial = path.with_suffix(".partial")
    with partial.open("wb") as stream:
        np.savez_compressed(
            stream,
            metadata=np.array(metadata),
            root_position=clip.root_position,
            root_quat=clip.root_quat,
            joint_angles=clip.joint_angles,
        )
    partial.replace(path)


def load_clip(path: Path) -> Clip:
    """Read and check one clip file.

    Raises:
        InputError: the file is missing, too large, not a clip, or holds bad values.
    """
    where = str(path)
    remedy = "make clips with `openclone motions`"
    if not path.is_file():
        raise InputError("no such clip file", where=where, remedy=remedy)
    if path.stat().st_size > MAX_FILE_BYTES:
        raise InputError("the file is larger than 256 MB", where=where)
    try:
        with zipfile.ZipFile(path) as archive:
            if sum(item.file_size for item in archive.infolist()) > 4 * MAX_FILE_BYTES:
                raise InputError("the arrays are larger than 1 GB", where=where)
        metadata = json.loads(str(unpack(path, "metadata")))
        arrays = [
            np.asarray(unpack(path, name), dtype=np.float64)
            for name in ("root_position", "root_quat", "joint_angles")
        ]
        if metadata.pop("format", None) != FORMAT:
            raise InputError(f"not a {FORMAT} file", where=where, remedy=remedy)
        texts = {name: str(value) for name, value in metadata.items()}
        info = ClipInfo(**{**texts, "fps": float(metadata["fps"])})
    except UNREADABLE as error:
        raise InputError(
            f"not a readable clip ({error})", where=where, remedy=remedy
        ) from error
    return check_clip(Clip(info, *arrays), where)


def clip_hash(clips: list[Clip]) -> str:
    """SHA-256 over the motions of ``clips``, to name a data set in a model card."""
    digest = hashlib.sha256()
    for clip in sorted(clips, key=lambda item: item.info.name):
        digest.update(clip.info.name.encode())
        digest.update(np.ascontiguousarray(clip.qpos, dtype="<f8").tobytes())
    return digest.hexdigest()
