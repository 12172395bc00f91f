"""The policy bundle: one ONNX file with everything needed to run the policy.

The metadata travels inside the ONNX file. Loading needs onnxruntime only, no torch.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, fields
from importlib import resources
from pathlib import Path

import numpy as np

from openclone.errors import InputError
from openclone.policy import observation
from openclone.robot import g1

FORMAT = "openclone-bundle-1"
MAX_FILE_BYTES = 64 * 1024 * 1024
MAX_HISTORY = 200
"""Frames; four seconds are more than any policy of this kind uses."""
_REMEDY = "export it again with `openclone train student`"


@dataclass(frozen=True)
class BundleInfo:
    """What a policy was trained for.

    Attributes:
        name: free text, e.g. the preset.
        layout: the observation layout, `observation.LAYOUT`.
        history: frames of history in the observation.
        observation_size: length of the input vector.
        joint_names: joint order of the output, 29 names.
        default_pose, action_scale: radians; target = default + scale x action.
        kp, kd: motor gains the policy was trained with, N m/rad and N m s/rad.
        control_hz: rate at which the policy runs.
        data_hash: SHA-256 over the training motions.
        training: free text: steps, minutes, data, date.
    """

    name: str
    layout: str
    history: int
    observation_size: int
    joint_names: tuple[str, ...]
    default_pose: tuple[float, ...]
    action_scale: tuple[float, ...]
    kp: tuple[float, ...]
    kd: tuple[float, ...]
    control_hz: float
    data_hash: str
    training: str


def g1_info(
    name: str, data_hash: str, training: str, history: int = observation.HISTORY
) -> BundleInfo:
    """Metadata of a student for the G1 with this project's table and layout."""
    return BundleInfo(
        name=name,
        layout=observation.LAYOUT,
        history=history,
        observation_size=observation.student_size(history),
        joint_names=g1.JOINT_NAMES,
        default_pose=tuple(g1.DEFAULT_POSE.tolist()),
        action_scale=tuple(g1.ACTION_SCALE.tolist()),
        kp=tuple(g1.KP.tolist()),
        kd=tuple(g1.KD.tolist()),
        control_hz=50.0,
        data_hash=data_hash,
        training=training,
    )


def write_metadata(path: Path, info: BundleInfo) -> None:
    """Store ``info`` in an exported ONNX file."""
    import onnx

    model = onnx.load(str(path))
    del model.metadata_props[:]
    for node in model.graph.node:  # torch leaves traces with the machine's paths
        del node.metadata_props[:]
    for key, value in {"format": FORMAT, **asdict(info)}.items():
        model.metadata_props.add(key=key, value=json.dumps(value))
    onnx.save(model, str(path))


class Bundle:
    """A loaded policy, ready to run."""

    def __init__(self, info: BundleInfo, session: object) -> None:
        """Wrap an onnxruntime session; use `load_bundle`."""
        self.info = info
        self._session = session

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Actions ``(n, 29)`` for observations ``(n, observation_size)``, float32."""
        inputs = {"observation": np.asarray(observations, dtype=np.float32)}
        return self._session.run(["action"], inputs)[0]  # type: ignore[attr-defined]


def packaged_bundle() -> Path:
    """The student that ships with OpenClone."""
    return Path(str(resources.files("openclone") / "weights" / "student.onnx"))


def load_bundle(path: Path | None = None) -> Bundle:
    """Load and check a bundle; the packaged student if ``path`` is None.

    Raises:
        InputError: the file is missing, not a bundle, or made for another robot or
            observation layout.
    """
    path = path or packaged_bundle()
    where = str(path)
    if not path.is_file():
        raise InputError("no such policy bundle", where=where, remedy=_REMEDY)
    if path.stat().st_size > MAX_FILE_BYTES:
        raise InputError("the file is larger than 64 MB", where=where)
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.log_severity_level = 4
    try:
        session = onnxruntime.InferenceSession(
            str(path), options, providers=["CPUExecutionProvider"]
        )
    except Exception as error:  # onnxruntime raises a dozen unrelated types
        line = str(error).splitlines()[0]
        raise InputError(
            f"not a readable ONNX file ({line})", where=where, remedy=_REMEDY
        ) from None
    properties = session.get_modelmeta().custom_metadata_map
    info = _check_info(properties, where)
    shape = session.get_inputs()[0].shape
    if shape[-1] != info.observation_size:
        raise InputError(
            f"the network takes {shape[-1]} values, its metadata says "
            f"{info.observation_size}",
            where=where,
            remedy=_REMEDY,
        )
    return Bundle(info, session)


def _check_history(info: BundleInfo, where: str) -> None:
    """The history's length is the bundle's choice; its input size follows from it."""
    history = info.history
    if type(history) is not int or not 1 <= history <= MAX_HISTORY:
        raise InputError(
            f"history is {history!r}, it must be 1 to {MAX_HISTORY} frames",
            where=where,
            remedy=_REMEDY,
        )
    wanted = observation.student_size(history)
    if info.observation_size != wanted:
        raise InputError(
            f"history is {history}, so observation_size must be {wanted}, "
            f"not {info.observation_size!r}",
            where=where,
            remedy=_REMEDY,
        )


def _check_info(properties: dict[str, str], where: str) -> BundleInfo:
    """Parse the metadata and compare it with this robot and observation layout."""
    try:
        values = {key: json.loads(text) for key, text in properties.items()}
        if values.pop("format") != FORMAT:
            raise ValueError("format")
        for field in fields(BundleInfo):
            if isinstance(values[field.name], list):
                values[field.name] = tuple(values[field.name])
        info = BundleInfo(**values)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"the ONNX metadata is not that of a {FORMAT} ({error})",
            where=where,
            remedy=_REMEDY,
        ) from None
    _check_history(info, where)
    expected = g1_info("", "", "")
    for name in ("layout", "joint_names", "control_hz"):
        found, wanted = getattr(info, name), getattr(expected, name)
        if found != wanted:
            raise InputError(
                f"{name} is {found!r}, this version of OpenClone needs {wanted!r}",
                where=where,
                remedy=_REMEDY,
            )
    for name in ("default_pose", "action_scale", "kp", "kd"):
        values = np.asarray(getattr(info, name), dtype=float)
        if values.shape != (g1.NUM_JOINTS,) or not np.isfinite(values).all():
            raise InputError(
                f"{name} must be {g1.NUM_JOINTS} finite numbers",
                where=where,
                remedy=_REMEDY,
            )
    return info
