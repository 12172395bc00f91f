"""Feed damaged files to the text readers of motion, for as long as you like.

``python benchmarks/fuzz_readers.py bvh --minutes 10`` runs one reader (``all``: each
in turn) under atheris, which steers by the coverage of the reader's code. Sound files
of two frames are damaged line by line, word by word and number by number as well as
byte by byte. A reader may return a motion or raise `InputError` that names file and
line; anything else, half a minute on one input, or 1 GB of memory is a failure; the
input is kept.
"""

from __future__ import annotations

import argparse
import functools
import json
import random
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "motion"))

import sample_recordings as samples

from openclone.errors import InputError

MEMORY_MB = 1024
TIMEOUT_S = 30
MAX_BYTES = 16384
"""Longer inputs only cost time: no reader looks further back than one frame."""
FRAMES = 2
"""Of the sound files; every further frame repeats what the first two show."""
_MODULES = (
    "bvh", "bvh_text", "asf_amc", "deepmimic", "mvnx", "g1_csv", "g1_clip",
    "text_lines",
)  # fmt: skip
HOSTILE = (
    b"", b"0", b"-1", b"1e999", b"-1e308", b"1e-320", b"nan", b"inf", b"1_0", b"0x10",
    b"99999999999999999999", b"1" * 5000, b"{", b"}", b"[", b"]", b",", b":", b"#",
    b"\xff\xfe", b"\x00", b"\r", b"\xe2\x80\xa8", b"JOINT", b"End", b"CHANNELS",
    b"MOTION", b"Frames:", b":bonedata", b":hierarchy", b"begin", b"end", b"root",
    b"dof", b"rx", b"null", b"[[]]", b'"Frames"', b"<frame>", b"</frame>",
    b"<!DOCTYPE a>", b"<!--", b"]]>", b"&lt;", b"&a;", b"Zposition", b"Xrotation",
)  # fmt: skip
"""Words that once broke some parser."""


def seed_files() -> dict[str, bytes]:
    """Reader -> a sound file."""
    truth = samples.make_truth(FRAMES)
    texts = {
        "bvh": samples.bvh(truth),
        "asf": samples.asf(),
        "amc": samples.amc(truth),
        "deepmimic": samples.deepmimic(FRAMES),
        "mvnx": samples.mvnx(truth),
        "csv": samples.g1_csv(FRAMES),
    }
    return {name: text.encode() for name, text in texts.items()}


_NUMBER = re.compile(rb"-?\d+(\.\d+)?")


def damage_number(data: bytes, rng: random.Random) -> bytes:
    """Change one number a little or a lot, so that it stays a number."""
    found = list(_NUMBER.finditer(data))
    if not found:
        return data
    place = rng.choice(found)
    text = place.group()
    match rng.randrange(6):
        case 0:
            text = b"-" + text
        case 1:
            text += b"e%d" % rng.randrange(-400, 400)
        case 2:
            text = text.split(b".")[0]
        case 3:
            text = b"%d" % (int(float(text[:15])) + rng.choice((-1, 1)))
        case 4:
            text = b"%d" % rng.choice((0, 2**31, 2**63, 10**9, rng.randrange(512)))
        case _:
            text = text * rng.randrange(2, 9)
    return data[: place.start()] + text + data[place.end() :]


def mutate(data: bytes, rng: random.Random) -> bytes:
    """One change that knows about lines and words."""
    if rng.random() < 0.25:
        return damage_number(data, rng)
    lines = data.split(b"\n")
    at, other = rng.randrange(len(lines)), rng.randrange(len(lines))
    words = re.split(rb"([ \t,<>=\"]+)", lines[at])
    place = rng.randrange(len(words))
    match rng.randrange(10):
        case 0:
            del lines[at]
        case 1:
            lines.insert(other, lines[at])
        case 2:
            lines[at], lines[other] = lines[other], lines[at]
        case 3:
            return data[: rng.randrange(len(data) + 1)]
        case 4:
            lines[at:at] = lines[other : other + rng.randrange(1, 40)]
        case 5:
            words[place] = rng.choice(re.split(rb"[ \t,]+", lines[other]))
            lines[at] = b"".join(words)
        case 6:
            words.insert(place, b" " + rng.choice(HOSTILE) + b" ")
            lines[at] = b"".join(words)
        case 7:
            del words[place]
            lines[at] = b"".join(words)
        case _:
            words[place] = rng.choice(HOSTILE)
            lines[at] = b"".join(words)
    return b"\n".join(lines)


def reader_of(name: str, folder: Path) -> Callable[[bytes], bool]:
    """A function that reads bytes as a file in ``folder``.

    It returns whether they are accepted, and fails on an error that is no `InputError`
    or does not name file and line.
    """
    from openclone.motion.sources import asf_amc, bvh, deepmimic, g1_csv, mvnx

    readers: dict[str, tuple[str, str, Callable[[Path], object]]] = {
        "bvh": ("m.bvh", "m.bvh", bvh.read),
        "asf": ("m.asf", "m_1.amc", asf_amc.read),
        "amc": ("m_1.amc", "m_1.amc", asf_amc.read),
        "deepmimic": ("m.txt", "m.txt", deepmimic.read),
        "mvnx": ("m.mvnx", "m.mvnx", mvnx.read),
        "csv": ("m.csv", "m.csv", g1_csv.read),
    }
    damaged, opened, read = readers[name]
    sound = seed_files()
    for other in ("asf", "amc"):
        (folder / readers[other][0]).write_bytes(sound[other])

    def run(data: bytes) -> bool:
        (folder / damaged).write_bytes(data)
        try:
            read(folder / opened)
        except InputError as error:
            if not re.search(r"m(_1)?\.\w+, line [1-9]", str(error)):
                raise AssertionError(f"no file and line: {error}") from error
            return False
        return True

    return run


def fuzz(name: str, folder: Path, words: list[str]) -> None:
    """Run libFuzzer, given ``words``, in this process, which it ends."""
    import atheris

    with atheris.instrument_imports(
        include=[f"openclone.motion.sources.{module}" for module in _MODULES]
    ):
        import openclone.motion.readers  # noqa: F401
        from openclone.motion.sources import asf_amc

    run = reader_of(name, folder)
    if name == "amc":
        # The skeleton beside the motion stays the same: read it once.
        asf_amc.read_skeleton = functools.cache(asf_amc.read_skeleton)
    sound = seed_files()[name]
    counts = {"accepted": 0, "rejected": 0}

    def one(data: bytes) -> None:
        with np.errstate(all="ignore"):
            counts["accepted" if run(data) else "rejected"] += 1
        if sum(counts.values()) % 500 == 0:
            Path(words[0]).with_suffix(".counts").write_text(json.dumps(counts))

    def change(data: bytes, most: int, seed: int) -> bytes:
        rng = random.Random(seed)
        if rng.random() < 0.3:
            return atheris.Mutate(data, most)
        if rng.random() < 0.4:
            data = sound
        for _ in range(rng.randrange(1, 4)):
            data = mutate(data, rng)
        return data[:most]

    atheris.Setup([sys.argv[0], *words], one, custom_mutator=change)
    atheris.Fuzz()


def _memory_disk() -> str | None:
    return "/dev/shm" if Path("/dev/shm").is_dir() else None


def supervise(name: str, minutes: float, out: Path) -> dict[str, object]:
    """Fuzz one reader in a process of its own; returns what became of it."""
    out.mkdir(parents=True, exist_ok=True)
    corpus = out / name
    corpus.mkdir(exist_ok=True)
    (corpus / "sound").write_bytes(seed_files()[name])
    options = [
        f"-max_total_time={round(60 * minutes)}",
        f"-rss_limit_mb={MEMORY_MB}",
        f"-timeout={TIMEOUT_S}",
        f"-max_len={MAX_BYTES}",
        "-print_final_stats=1",
        f"-artifact_prefix={out}/{name}_",
    ]
    with tempfile.TemporaryDirectory(prefix="fuzz_", dir=_memory_disk()) as folder:
        command = [sys.executable, __file__, name, "--child", folder, str(corpus)]
        done = subprocess.run(
            [*command, *options], capture_output=True, text=True, check=False
        )
    log = done.stdout + done.stderr
    (out / f"{name}.log").write_text(log)
    stats = dict(re.findall(r"stat::(\w+):\s+(\d+)", log))
    counts_file = corpus.with_suffix(".counts")
    counts = json.loads(counts_file.read_text()) if counts_file.is_file() else {}
    covered = re.findall(r"cov: (\d+)", log)
    return {
        "reader": name,
        "minutes": minutes,
        "inputs": int(stats.get("number_of_executed_units", 0)),
        "peak_memory_mb": int(stats.get("peak_rss_mb", 0)),
        "covered": int(covered[-1]) if covered else 0,
        **counts,
        "failed": done.returncode != 0,
    }


def main() -> int:
    """Command line; returns 1 if a reader failed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("reader", choices=[*seed_files(), "all"])
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--out", type=Path, default=Path("fuzzing"))
    parser.add_argument("--json", type=Path)
    parser.add_argument("--child", nargs=argparse.REMAINDER, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        folder, *words = options.child
        fuzz(options.reader, Path(folder), words)
    names = list(seed_files()) if options.reader == "all" else [options.reader]
    results = []
    for name in names:
        results.append(supervise(name, options.minutes, options.out))
        print(json.dumps(results[-1]), flush=True)
    if options.json:
        options.json.write_text(json.dumps(results, indent=2) + "\n")
    return int(any(result["failed"] for result in results))


if __name__ == "__main__":
    sys.exit(main())
