"""Devices and back-ends: one code for all, and nothing needed that a GPU lacks."""

import ast
import platform
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import openclone
from openclone.errors import InputError
from openclone.motion.clip import save_clip
from openclone.training import student as student_module
from openclone.training.checkpoint import load_checkpoint, save_checkpoint
from openclone.training.data import load_reference
from openclone.training.hardware import Hardware, on_one_thread
from openclone.training.presets import STUDENTS, TEACHERS
from openclone.training.student import train_student
from openclone.training.teacher import train_teacher
from openclone.training.terrain import build_training_model, save_training_model

SOURCE = Path(openclone.__file__).parent
FACTORIES = {
    "arange", "as_tensor", "empty", "eye", "full", "linspace", "ones", "rand",
    "randint", "randn", "randperm", "tensor", "zeros",
}  # fmt: skip
# On the CPU on purpose: host-side draws, broadcast decisions, files, examples that
# only size a network, scalars for the log, and what `build_reference` moves afterwards.
ON_THE_HOST = {
    "training/task.py": {"randint", "arange"},
    "training/starts.py": {"randint"},
    "training/distributed.py": {"tensor"},
    "training/guard.py": {"tensor", "as_tensor"},
    "training/reference.py": {"tensor"},
    "training/teacher.py": {"zeros"},
    "policy/moe.py": {"zeros"},
    "policy/student.py": {"zeros"},
}


def homeless(text: str) -> list[str]:
    """Factories of torch that are called without saying where."""
    found = []
    for node in ast.walk(ast.parse(text)):
        if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)):
            continue
        owner = node.func.value
        of_torch = isinstance(owner, ast.Name) and owner.id == "torch"
        placed = any(keyword.arg == "device" for keyword in node.keywords)
        if of_torch and node.func.attr in FACTORIES and not placed:
            found.append(node.func.attr)
    return found


def test_the_search_finds_tensors_without_a_device():
    assert homeless("x = torch.zeros(3)\ny = torch.ones(2, device=d)") == ["zeros"]


@pytest.mark.parametrize("room", ["training", "policy"])
def test_every_tensor_says_where_it_lives(room):
    for path in sorted((SOURCE / room).glob("*.py")):
        place = f"{room}/{path.name}"
        left = set(homeless(path.read_text())) - ON_THE_HOST.get(place, set())
        assert not left, f"{place}: torch.{', torch.'.join(left)} without device="


# The training path on a bare machine -------------------------------------------------

_HIDDEN = (
    "viser", "mjviser", "cyclonedds", "mjlab", "mink", "onnxruntime", "tyro", "av",
    "matplotlib", "numba", "daqp",
)  # fmt: skip
_BARE = """
import sys
from pathlib import Path

class Hidden:
    def __init__(self, finder):
        self.finder = finder
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {hidden!r}:
            return None
        return self.finder.find_spec(name, path, target)

sys.meta_path[:] = [Hidden(finder) for finder in sys.meta_path]
from dataclasses import replace
from openclone.motion.clip import load_clip
from openclone.training.hardware import Hardware
from openclone.training.presets import TEACHERS
from openclone.training.teacher import train_teacher
import openclone.training.student, openclone.training.warp_physics

preset = replace(TEACHERS["smoke"], iterations=1)
folder = Path(sys.argv[1])
hardware = Hardware(model=folder / "g1.mjb")
clips = [load_clip(folder / "clip.npz")]
train_teacher(clips, preset, folder, threads=1, hardware=hardware)
"""


def test_training_needs_neither_mjlab_nor_a_viewer(make_clip, tmp_path):
    save_clip(make_clip(), tmp_path / "clip.npz")
    save_training_model(tmp_path / "g1.mjb")
    script = tmp_path / "bare.py"
    script.write_text(_BARE.format(hidden=set(_HIDDEN)))
    result = subprocess.run(
        [sys.executable, str(script), str(tmp_path)], capture_output=True, text=True
    )
    assert result.returncode == 0, result.stderr[-2000:]
    assert load_checkpoint(tmp_path / "teacher.pt")["iterations"] == 1


def test_the_carried_model_is_the_training_model(make_clip, tmp_path):
    path = tmp_path / "g1.mjb"
    save_training_model(path)
    ours, carried = build_training_model(), build_training_model(file=path)
    for name in ("body_mass", "geom_size", "actuator_gainprm", "sensor_adr"):
        np.testing.assert_array_equal(getattr(carried, name), getattr(ours, name))
    assert carried.opt.disableflags == ours.opt.disableflags
    assert carried.opt.timestep == ours.opt.timestep
    references = [
        load_reference([make_clip()], hardware)
        for hardware in (None, Hardware(model=path))
    ]
    assert torch.equal(references[0].table, references[1].table)


def test_bad_models_and_devices_are_refused(make_clip, tmp_path):
    with pytest.raises(InputError, match="no such model"):
        build_training_model(file=tmp_path / "none.mjb")
    (tmp_path / "bad.mjb").write_bytes(b"nothing")
    with pytest.raises(InputError, match="not a model"):
        build_training_model(file=tmp_path / "bad.mjb")
    with pytest.raises(InputError, match="unknown physics"):
        Hardware("isaac").torch_device()
    with pytest.raises(InputError, match="unknown device"):
        Hardware(device="gpu").torch_device()
    if not torch.cuda.is_available():
        with pytest.raises(InputError, match="0 CUDA devices"):
            train_teacher(
                [make_clip()],
                TEACHERS["smoke"],
                tmp_path,
                hardware=Hardware(device="cuda"),
            )


# MuJoCo Warp -------------------------------------------------------------------------


@pytest.mark.timeout(240)
def test_teacher_and_student_train_on_warp(make_clip, tmp_path, monkeypatch):
    monkeypatch.setattr(student_module, "export_bundle", lambda *_: None)
    hardware, clips = Hardware("warp", "cpu"), [make_clip()]
    few = replace(TEACHERS["smoke"].task, num_envs=4)
    teacher = replace(TEACHERS["smoke"], iterations=2, task=few)
    path = train_teacher(clips, teacher, tmp_path, hardware=hardware)
    assert load_checkpoint(path)["steps"] == 2 * 4 * 4
    student = replace(
        STUDENTS["smoke"],
        iterations=1,
        tuning_iterations=1,
        task=few,
        tuning_task=few,
    )
    train_student(clips, path, student, tmp_path, hardware=hardware)
    content = load_checkpoint(tmp_path / "student.pt")
    assert content["phase"] == "tuning"
    assert all(torch.isfinite(v).all() for v in content["student"].values())


def test_checkpoints_hold_plain_cpu_tensors(tmp_path):
    content = {"a": [torch.ones(2, requires_grad=True)], "b": {"c": (1, "x")}}
    save_checkpoint(tmp_path / "x.pt", content)
    found = load_checkpoint(tmp_path / "x.pt")
    assert found["b"] == {"c": (1, "x")}
    assert not found["a"][0].requires_grad


def test_small_operations_run_on_one_thread_and_others_as_before():
    inside = []

    @on_one_thread
    def work(fails: bool) -> str:
        inside.append(torch.get_num_threads())
        if fails:
            raise ValueError("no")
        return "done"

    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        assert work(False) == "done"
        with pytest.raises(ValueError, match="no"):
            work(True)
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)
    assert inside == [1, 1]


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="a setting of glibc")
@pytest.mark.parametrize(("keep", "given_back"), [("", True), ("keep_memory()", False)])
def test_freed_memory_is_kept_for_the_next_tensor(keep, given_back):
    code = (
        "import torch\n"
        "from openclone.training.hardware import keep_memory\n"
        "def held():\n"
        "    pages = int(open('/proc/self/statm').read().split()[1])\n"
        "    return pages * 4096\n"
        f"{keep}\n"
        "tensor = torch.ones(4_000_000)\n"
        "before = held()\n"
        "del tensor\n"
        "print(before - held() > 8_000_000)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120
    )
    assert done.stdout.split() == [str(given_back)], done.stderr
