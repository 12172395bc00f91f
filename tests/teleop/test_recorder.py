from pathlib import Path

import numpy as np
import pytest

from openclone.errors import InputError
from openclone.policy.bundle import Bundle
from openclone.teleop.messages import OperatorRecording
from openclone.teleop.recorder import TickLog, TickRecorder, load_log, save_log
from openclone.teleop.session import run_teleop


@pytest.fixture
def log(bundle: Bundle, walking: OperatorRecording) -> TickLog:
    return run_teleop(walking, bundle, seconds=0.3, realtime=False).log


def test_a_log_survives_the_file(log: TickLog, tmp_path: Path) -> None:
    path = tmp_path / "deep" / "session.npz"
    save_log(log, path)
    back = load_log(path)
    assert back.num_ticks == 15
    for name, values in vars(log).items():
        np.testing.assert_array_equal(getattr(back, name), values)
    assert [item.name for item in path.parent.iterdir()] == ["session.npz"]


def test_memory_is_bounded(bundle: Bundle, walking: OperatorRecording) -> None:
    small = TickRecorder(max_ticks=4)
    run_teleop(walking, bundle, seconds=0.2, realtime=False, subscribers=(small,))
    assert len(small.ticks) == 4
    assert small.dropped == 6
    assert small.log().num_ticks == 4


def test_bad_files_are_refused(log: TickLog, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such session"):
        load_log(tmp_path / "missing.npz")
    garbage = tmp_path / "garbage.npz"
    garbage.write_bytes(b"PK nonsense")
    with pytest.raises(InputError, match="not a readable session"):
        load_log(garbage)
    good = tmp_path / "good.npz"
    save_log(log, good)
    truncated = tmp_path / "truncated.npz"
    truncated.write_bytes(good.read_bytes()[:-200])
    with pytest.raises(InputError, match="not a readable session"):
        load_log(truncated)
    arrays = dict(np.load(good))
    arrays["qpos"] = arrays["qpos"][:, :5]
    np.savez(tmp_path / "shape.npz", **arrays)
    with pytest.raises(InputError, match=r"qpos has shape \(15, 5\)"):
        load_log(tmp_path / "shape.npz")
    arrays["qpos"] = np.array([object()])
    np.savez(tmp_path / "pickle.npz", allow_pickle=True, **arrays)
    with pytest.raises(InputError, match="not a readable session"):
        load_log(tmp_path / "pickle.npz")
