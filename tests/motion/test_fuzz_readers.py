"""Damaged files: every reader returns a motion or an error that names the place."""

from __future__ import annotations

import io
import random
import re
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fuzz_readers import mutate, reader_of, seed_files
from openclone.errors import InputError
from openclone.motion import readers
from openclone.motion.skeleton_maps import FOLDER, load_map
from openclone.robot import g1

FUZZ = settings(
    max_examples=40,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


@pytest.mark.parametrize("name", sorted(seed_files()))
def test_sound_files_are_accepted(tmp_path: Path, name: str) -> None:
    assert reader_of(name, tmp_path)(seed_files()[name])


@pytest.mark.parametrize("name", sorted(seed_files()))
@FUZZ
@given(seed=st.integers(0, 2**32), changes=st.integers(1, 4))
def test_damaged_text(tmp_path: Path, name: str, seed: int, changes: int) -> None:
    rng = random.Random(seed)
    data = seed_files()[name]
    for _ in range(changes):
        data = mutate(data, rng)
    reader_of(name, tmp_path)(data)


@pytest.mark.parametrize("name", sorted(seed_files()))
@FUZZ
@given(data=st.binary(max_size=300), at=st.floats(0, 1))
def test_foreign_bytes_in_text(
    tmp_path: Path, name: str, data: bytes, at: float
) -> None:
    sound = seed_files()[name]
    place = int(at * len(sound))
    reader_of(name, tmp_path)(sound[:place] + data + sound[place + len(data) :])
    reader_of(name, tmp_path)(data)


def arrays_of(kind: str) -> dict[str, Any]:
    count = 4
    poses = np.zeros((count, 156))
    poses[:, 0] = np.pi / 2
    unit = np.tile([0.0, 0, 0, 1], (count, 1))
    return {
        "amass": {
            "poses": poses, "trans": np.full((count, 3), 0.9),
            "mocap_framerate": np.array(120.0),
        },
        "gmr": {
            "fps": np.array(30.0), "root_pos": np.full((count, 3), 0.8),
            "root_rot": unit, "dof_pos": np.zeros((count, g1.NUM_JOINTS)),
        },
        "clip": {
            "metadata": np.array('{"format": "openclone-clip-1"}'),
            "root_position": np.zeros((count, 3)), "root_quat": unit[:, ::-1],
            "joint_angles": np.zeros((count, g1.NUM_JOINTS)),
        },
        "mjlab": {
            "fps": np.array([50]), "joint_pos": np.zeros((count, g1.NUM_JOINTS)),
            "body_pos_w": np.zeros((count, 30, 3)),
            "body_quat_w": np.tile([1.0, 0, 0, 0], (count, 30, 1)),
        },
    }[kind]  # fmt: skip


def packed(arrays: dict[str, Any]) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def accepts(path: Path) -> bool:
    """Whether the file is a motion; fails on anything but an `InputError`."""
    try:
        readers.read_motion(path)
    except InputError as error:
        return _named(path, error)
    return True


def _named(path: Path, error: InputError) -> bool:
    """False; fails if the error does not name the file."""
    assert str(path) in str(error)
    return False


@pytest.mark.parametrize("kind", ["amass", "gmr"])
def test_sound_arrays_are_accepted(tmp_path: Path, kind: str) -> None:
    (tmp_path / "m.npz").write_bytes(packed(arrays_of(kind)))
    assert accepts(tmp_path / "m.npz")


@pytest.mark.parametrize("kind", ["amass", "gmr", "clip", "mjlab"])
@FUZZ
@given(
    flips=st.lists(st.tuples(st.floats(0, 1), st.integers(0, 255)), max_size=6),
    cut=st.one_of(st.just(1.0), st.floats(0, 1)),
)
def test_damaged_arrays(
    tmp_path: Path, kind: str, flips: list[tuple[float, int]], cut: float
) -> None:
    """Bytes changed or missing anywhere in the zip file."""
    data = bytearray(packed(arrays_of(kind)))
    for at, value in flips:
        data[int(at * (len(data) - 1))] = value
    path = tmp_path / "m.npz"
    path.write_bytes(bytes(data[: int(cut * len(data))]))
    accepts(path)


HEADERS = st.builds(
    "{{'descr': {}, 'fortran_order': {}, 'shape': {}, }}".format,
    st.sampled_from(
        ["'<f8'", "'|O'", "'<U4'", "'<c16'", "('<f8', 3)", "[]", "'x'", ""]
    ),
    st.sampled_from(["False", "True", "None", "0"]),
    st.one_of(
        st.lists(st.integers(-2, 2**70), max_size=40).map(tuple).map(str),
        st.sampled_from(["()", "(3,)", "[3]", "3", "(" * 300, "(" * 300 + ")" * 300]),
    ),
)


@FUZZ
@given(header=HEADERS, version=st.integers(0, 4), rows=st.integers(0, 40))
def test_hostile_array_headers(
    tmp_path: Path, header: str, version: int, rows: int
) -> None:
    """The zip file is sound; the array in it lies about itself."""
    path = tmp_path / "m.npz"
    text = header.encode("latin-1", "replace") + b"\n"
    size = 2 if version == 1 else 4
    member = b"\x93NUMPY" + bytes((version, 0)) + len(text).to_bytes(size, "little")
    with zipfile.ZipFile(path, "w") as archive:
        for name in arrays_of("gmr"):
            archive.writestr(f"{name}.npy", member + text + b"\x00" * 8 * rows)
    assert not accepts(path)


@FUZZ
@given(seed=st.integers(0, 2**32), changes=st.integers(1, 4))
def test_damaged_skeleton_maps(tmp_path: Path, seed: int, changes: int) -> None:
    rng = random.Random(seed)
    sound = rng.choice(sorted(FOLDER.glob("*.toml"))).read_bytes()
    for _ in range(changes):
        sound = mutate(sound, rng)
    path = tmp_path / "a.skeleton.toml"
    path.write_bytes(sound)
    try:
        load_map(path)
    except InputError as error:
        _named(path, error)


def test_nothing_reads_pickles() -> None:
    """No module of the room imports pickle or lets NumPy unpickle."""
    for path in FOLDER.parent.rglob("*.py"):
        text = path.read_text()
        imports = re.search(
            r"^\s*(import|from) (pickle|dill|joblib|shelve)", text, re.M
        )
        assert imports is None, path
        assert "allow_pickle=True" not in text, path
        for call in re.findall(r"np\.load\([^)]*\)", text):
            assert "allow_pickle=False" in call, path
