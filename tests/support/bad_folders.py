"""Results folders as strangers, power cuts and editors leave them, and how a command ends on them.

Each case takes a folder that a run wrote, damages one file of it by a seeded draw, and gives it to
a command.  It must be refused with one message, or used as it stands; nothing may be executed,
nothing outside be written, and no link be followed.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import pickle
import shutil
import signal
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayes_sensor.campaign import CampaignError

Rng = np.random.Generator
SECONDS = 20
ZEROS = 60_000_000
"""in an archive that unpacks to far more than it holds"""
OUTSIDE = "secret.json"
"""a file beside the folder: never read into it, never changed"""
MINE = "my notes.txt"
"""a file of the user's inside: never changed"""


class Damage(Exception):
    """What a command did, though it must not."""


@dataclass(frozen=True)
class Case:
    """A damaged folder and the command that gets it."""

    base: str
    command: str
    file: str
    kind: str


class Trap:
    """An object whose pickle creates a file when it is loaded."""

    def __init__(self, canary: str) -> None:
        self.canary = canary

    def __reduce__(self) -> tuple[Any, ...]:
        return open, (self.canary, "w")


# --------------------------------------------------------------------------- any file


def truncated(content: bytes, rng: Rng) -> bytes:
    return content[: int(rng.integers(len(content)))]


def flipped(content: bytes, rng: Rng) -> bytes:
    found = bytearray(content)
    for _ in range(int(rng.integers(1, 12))):
        found[int(rng.integers(len(found)))] ^= 1 << int(rng.integers(8))
    return bytes(found)


def noise(content: bytes, rng: Rng) -> bytes:
    return rng.bytes(int(rng.integers(1, 4000)))


def padded(content: bytes, rng: Rng) -> bytes:
    return content + rng.bytes(50)


def emptied(content: bytes, rng: Rng) -> bytes:
    return b""


BYTES = {f.__name__: f for f in (truncated, flipped, noise, padded, emptied)}


def _replace(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def linked(path: Path, rng: Rng) -> None:
    """A link to the file itself, outside: what it points to is good, and must not be followed."""
    outside = Path(os.environ["BAD_FOLDERS"]) / "elsewhere" / path.name
    outside.parent.mkdir(exist_ok=True)
    shutil.copy(path, outside)
    _replace(path)
    path.symlink_to(outside)


def looped(path: Path, rng: Rng) -> None:
    _replace(path)
    path.symlink_to(path.name)


def endless(path: Path, rng: Rng) -> None:
    _replace(path)
    path.symlink_to("/dev/zero")


def pipe(path: Path, rng: Rng) -> None:
    _replace(path)
    os.mkfifo(path)


def folder(path: Path, rng: Rng) -> None:
    _replace(path)
    path.mkdir()


def missing(path: Path, rng: Rng) -> None:
    _replace(path)


def exchanged(path: Path, rng: Rng) -> None:
    """The content of another file of the folder."""
    others = [p for p in sorted(path.parent.iterdir()) if p.is_file() and p != path]
    if others:
        path.write_bytes(others[int(rng.integers(len(others)))].read_bytes())


PLACES = {
    f.__name__: f for f in (linked, looped, endless, pipe, folder, missing, exchanged)
}  # fmt: skip

# --------------------------------------------------------------------------- JSON

ODD: Sequence[Any] = (
    None, True, False, 0, -1, 1, 2**62, 10**400, 0.5, -1e-300, 1e99, 1e308, "", "x", "1.5",
    "../../secret.json", "/etc/passwd", "\ud800", "<script>alert(1)</script>", "\x00", "A" * 5000,
    [], [None], [[]], {}, {"a": {}}, [1e308, -1e308], "__import__('os')", 999, "none", "tau_s",
    float("nan"), float("inf"), -float("inf"),
)  # fmt: skip


def nodes(content: Any, place: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The place of every value, those near the top no rarer than those of long lists."""
    if isinstance(content, dict):
        items: Sequence[tuple[Any, Any]] = list(content.items())
    elif isinstance(content, list):
        items = list(enumerate(content))[:4]
    else:
        return
    for key, value in items:
        yield (*place, key)
        yield from nodes(value, (*place, key))


def _parent(content: Any, place: tuple[Any, ...]) -> Any:
    for key in place[:-1]:
        content = content[key]
    return content


def edited(content: bytes, rng: Rng) -> bytes:
    """One to three values replaced by others."""
    made = json.loads(content)
    for _ in range(int(rng.integers(1, 4))):
        places = list(nodes(made))
        if not places:
            break
        place = places[int(rng.integers(len(places)))]
        parent, value = _parent(made, place), ODD[int(rng.integers(len(ODD)))]
        parent[place[-1]] = value
    return json.dumps(made).encode()


def lacking(content: bytes, rng: Rng) -> bytes:
    """One key or entry less."""
    made = json.loads(content)
    places = list(nodes(made))
    if places:
        place = places[int(rng.integers(len(places)))]
        del _parent(made, place)[place[-1]]
    return json.dumps(made).encode()


def renamed(content: bytes, rng: Rng) -> bytes:
    """A key by another name."""
    made = json.loads(content)
    places = [p for p in nodes(made) if isinstance(p[-1], str)]
    if places:
        place = places[int(rng.integers(len(places)))]
        parent = _parent(made, place)
        parent[("../x", "", "é" * 300, "none")[int(rng.integers(4))]] = parent.pop(place[-1])
    return json.dumps(made).encode()


def rescaled(content: bytes, rng: Rng) -> bytes:
    """A number times a power of ten, or a list cut, doubled or emptied."""
    made = json.loads(content)
    places = list(nodes(made))
    order = rng.permutation(len(places))
    for i in order:
        parent, key = _parent(made, places[i]), places[i][-1]
        value = parent[key]
        if isinstance(value, list):
            parent[key] = (value[:1], value * 2, [], value[::-1])[int(rng.integers(4))]
            break
        if isinstance(value, int | float) and not isinstance(value, bool):
            parent[key] = (
                -value if rng.random() < 0.3 else value * 10.0 ** int(rng.integers(-90, 90))
            )
            break
    return json.dumps(made).encode()


def repeated(content: bytes, rng: Rng) -> bytes:
    """A key twice."""
    made = json.loads(content)
    if not (isinstance(made, dict) and made):
        return content[:-1]
    key = list(made)[int(rng.integers(len(made)))]
    return json.dumps(made)[:-1].encode() + f", {json.dumps(key)}: null}}".encode()


def nested(content: bytes, rng: Rng) -> bytes:
    n = int(10 ** rng.uniform(2.5, 6.5))
    return b"[" * n + b"]" * n if rng.random() < 0.5 else b'{"a":' * n + b"1" + b"}" * n


def vast(content: bytes, rng: Rng) -> bytes:
    return b"[" + b"0," * 18_000_000 + b"0]"


def encoded(content: bytes, rng: Rng) -> bytes:
    return (
        content.decode().encode("utf-16"), b"\xef\xbb\xbf" + content,
        content.replace(b"a", b"\xff"), content.replace(b"e", b"\\ud83d", 1),
        content.replace(b"1", b"1e999", 1),
        content.replace(b"0", b"NaN", 1), b"// a comment\n" + content,
    )[int(rng.integers(7))]  # fmt: skip


def versioned(content: bytes, rng: Rng) -> bytes:
    made = json.loads(content)
    if isinstance(made, dict):
        made["version"] = (999, 0, "1", None, -1)[int(rng.integers(5))]
    return json.dumps(made).encode()


JSON = {
    f.__name__: f
    for f in (edited, lacking, renamed, rescaled, repeated, nested, vast, encoded, versioned)
}
OFTEN = ("edited", "lacking", "rescaled")
"""kinds that are drawn several times as often as others"""

# --------------------------------------------------------------------------- NumPy archives


def npy(array: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, array, allow_pickle=True)
    return buffer.getvalue()


def members(content: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def packed(found: Mapping[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as archive:
        for name, content in found.items():
            archive.writestr(name, content)
    return buffer.getvalue()


def _some(found: Mapping[str, bytes], rng: Rng) -> str:
    return list(found)[int(rng.integers(len(found)))]


def pickled(content: bytes, rng: Rng) -> bytes:
    """An array of objects whose loading would create a file."""
    found = members(content)
    trap = np.empty(1, dtype=object)
    trap[0] = Trap(str(Path(os.environ["BAD_FOLDERS"]) / "executed"))
    found[_some(found, rng)] = npy(trap)
    return packed(found) if rng.random() < 0.7 else pickle.dumps(trap[0])


def bomb(content: bytes, rng: Rng) -> bytes:
    """Zeros that take hardly any room."""
    found = members(content)
    found[_some(found, rng)] = npy(np.zeros(ZEROS))
    return packed(found)


def without(content: bytes, rng: Rng) -> bytes:
    found = members(content)
    del found[_some(found, rng)]
    return packed(found)


def reshaped(content: bytes, rng: Rng) -> bytes:
    """An array of another shape, kind or content."""
    found = members(content)
    name = _some(found, rng)
    array = np.load(io.BytesIO(found[name]))
    number = array.astype(float) if array.dtype.kind in "biuf" else np.zeros(3)
    made: Sequence[np.ndarray] = (
        array[..., None], array.reshape(-1), array[:0] if array.ndim else array, np.array(7.0),
        number.astype(complex), number.astype("U9"), number * np.nan, number * 1e300,
        np.full(array.shape, np.inf), (number * 0).astype(bool), np.atleast_1d(number)[..., :1],
        number.astype("f2"), -number, number.astype(">f8"),
        np.concatenate([number.reshape(-1)] * 2),
    )  # fmt: skip
    with np.errstate(all="ignore"):
        found[name] = npy(np.asarray(made[int(rng.integers(len(made)))]))
    return packed(found)


def lying(content: bytes, rng: Rng) -> bytes:
    """A header that promises other sizes than there are."""
    found = members(content)
    name = _some(found, rng)
    shape = ("(10**12,)", "(1000000000000,)", "(-5,)", "(3, 'x')", "(" * 300 + ")" * 300)
    text = shape[int(rng.integers(len(shape)))]
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {text}, }}".encode()
    header = header.ljust(1014) + b"\n"
    found[name] = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + bytes(64)
    return packed(found)


def misnamed(content: bytes, rng: Rng) -> bytes:
    found = members(content)
    name = _some(found, rng)
    new = ("../../escaped.npy", "/tmp/x.npy", "é.npy", name + ".npy", "a")[int(rng.integers(5))]
    found[new] = found.pop(name)
    return packed(found)


def facts_edited(content: bytes, rng: Rng) -> bytes:
    """Other facts beside the same arrays."""
    found = members(content)
    if "facts.npy" not in found:
        return packed({**found, "more.npy": npy(np.zeros(3))})
    facts = np.load(io.BytesIO(found["facts.npy"])).tobytes()
    change = (edited, lacking, rescaled, versioned, nested)[int(rng.integers(5))]
    made = np.frombuffer(change(facts, rng), dtype=np.uint8)
    found["facts.npy"] = npy(made)
    return packed(found)


def method(content: bytes, rng: Rng) -> bytes:
    return packed(members(content), (zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA)[int(rng.integers(2))])


NPZ = {
    f.__name__: f for f in (pickled, bomb, without, reshaped, lying, misnamed, facts_edited, method)
}

# --------------------------------------------------------------------------- netCDF


def netcdf(change: Callable[[Any, Rng], None]) -> Callable[[bytes, Rng], bytes]:
    def changed(content: bytes, rng: Rng) -> bytes:
        import h5py

        buffer = io.BytesIO(content)
        with h5py.File(buffer, "r+") as file:
            change(file, rng)
        return buffer.getvalue()

    return changed


def _variable(file: Any, rng: Rng) -> str:
    names = [n for n in file["posterior"] if n not in ("chain", "draw", "experiment")]
    return str(names[int(rng.integers(len(names)))])


def nc_bomb(file: Any, rng: Rng) -> None:
    file["posterior"].create_dataset("tau_x", shape=(10**7, 10**5), dtype="f8", chunks=(100, 100))


def nc_link(file: Any, rng: Rng) -> None:
    import h5py

    name = _variable(file, rng)
    del file["posterior"][name]
    links = (
        h5py.ExternalLink("/etc/passwd", "/x"), h5py.SoftLink("/posterior"), h5py.SoftLink("/none"),
    )  # fmt: skip
    file["posterior"][name] = links[int(rng.integers(3))]


def nc_round(file: Any, rng: Rng) -> None:
    file["posterior"]["again"] = file["/"]


def nc_nan(file: Any, rng: Rng) -> None:
    file["posterior"][_variable(file, rng)][...] = (np.nan, np.inf, 1e300)[int(rng.integers(3))]


def nc_attribute(file: Any, rng: Rng) -> None:
    variable = file["posterior"][_variable(file, rng)]
    if rng.random() < 0.5:
        variable.attrs["parameter"] = ("", "../x", 3.0, "V_mL")[int(rng.integers(4))]
    else:
        del variable.attrs["parameter"]


def nc_type(file: Any, rng: Rng) -> None:
    name = _variable(file, rng)
    shape = file["posterior"][name].shape
    del file["posterior"][name]
    file["posterior"].create_dataset(
        name,
        data=(np.zeros(3), np.zeros(shape, dtype=int), np.array(b"text"))[int(rng.integers(3))],
    )


NC = {
    f.__name__: netcdf(f) for f in (nc_bomb, nc_link, nc_round, nc_nan, nc_attribute, nc_type)
}  # fmt: skip


def kinds_of(file: str) -> dict[str, Callable[[bytes, Rng], bytes]]:
    """The damages to the content of a file, by its ending."""
    if file.endswith((".json", ".lock")):
        return {**BYTES, **JSON}
    return {**BYTES, **(NPZ if file.endswith(".npz") else NC if file.endswith(".nc") else {})}


# --------------------------------------------------------------------------- cases


def files_of(base: Path) -> list[str]:
    """Everything in a folder that a command reads back."""
    found = [p.relative_to(base).as_posix() for p in sorted(base.rglob("*")) if p.is_file()]
    read = (".json", ".npz", ".nc", "cases.csv", ".toml", ".txt")
    return [f for f in found if f.endswith(read) and MINE not in f and not f.startswith("inputs/")]


def draw(bases: Mapping[str, Path], commands: Mapping[str, Sequence[str]], rng: Rng) -> Case:
    """A case: a base, one of its commands, one of its files and a damage."""
    pairs = [(base, command) for base in bases for command in commands[base]]
    base, command = pairs[int(rng.integers(len(pairs)))]
    parts = ("checkpoint/", "-parts/")  # read by --resume alone
    files = [
        file for file in files_of(bases[base])
        if "--resume" in command or not any(part in file for part in parts)
    ]  # fmt: skip
    file = str(rng.choice(files))
    inside = kinds_of(file)
    weights = np.array([4.0 if name in OFTEN else 0.4 if name in ("vast", "bomb") else 1.0
                        for name in (*inside, *PLACES)])  # fmt: skip
    kind = str(rng.choice([*inside, *PLACES], p=weights / weights.sum()))
    return Case(base, command, file, kind)


def digest(folder: Path) -> dict[str, str]:
    """Hashes of the files below a folder; links are not followed."""
    found = {}
    for place, folders, names in os.walk(folder):
        for name in [*names, *(f for f in folders if (Path(place) / f).is_symlink())]:
            path = Path(place) / name
            kind = path.lstat()
            content = path.read_bytes() if path.is_file() and not path.is_symlink() else b""
            found[str(path)] = hashlib.sha256(content).hexdigest() + str(kind.st_mode)
    return found


@contextlib.contextmanager
def time_limit(seconds: int) -> Iterator[None]:
    """Raise Damage after so much processor time, or ten times that of waiting."""

    def stop(*_: Any) -> None:
        raise Damage(f"it takes more than {seconds} s")

    before = [signal.signal(each, stop) for each in (signal.SIGPROF, signal.SIGALRM)]
    signal.setitimer(signal.ITIMER_PROF, seconds)
    signal.alarm(10 * seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.alarm(0)
        signal.signal(signal.SIGPROF, before[0])
        signal.signal(signal.SIGALRM, before[1])


def try_case(
    case: Case,
    bases: Mapping[str, Path],
    run: Callable[[str, Path], tuple[int, str]],
    place: Path,
    rng: Rng,
) -> str:
    """``refused`` or ``used``; Damage where the command did what it must not.

    ``run``: command and folder to exit code and stderr.
    """
    shutil.rmtree(place, ignore_errors=True)
    (place / "outside").mkdir(parents=True)
    os.environ["BAD_FOLDERS"] = str(place)
    out = place / "out"
    shutil.copytree(bases[case.base], out)
    (out / MINE).write_text("mine")
    (place / "outside" / OUTSIDE).write_text('{"secret": 1}')
    file = out / case.file
    if case.kind in PLACES:
        PLACES[case.kind](file, rng)
    else:
        file.write_bytes(kinds_of(case.file)[case.kind](file.read_bytes(), rng))
    elsewhere = digest(place / "outside"), digest(place / "elsewhere")
    try:
        with time_limit(SECONDS):
            code, said = run(case.command, out)
    except CampaignError as error:
        code, said = 2, f"error: {error}"
    if elsewhere != (digest(place / "outside"), digest(place / "elsewhere")):
        raise Damage("a file outside was changed")
    if (place / "executed").exists():
        raise Damage("a pickle was executed")
    if (out / MINE).read_text() != "mine":
        raise Damage("a file of the user's was changed")
    if code in (0, 3):
        return "used"
    lines = [line for line in said.splitlines() if line and not line.startswith("warning: ")]
    if code != 2 or len(lines) != 1 or not lines[0].startswith("error: "):
        raise Damage(f"exit {code}: {said[-300:]}")
    for word in ("allow_pickle", "Traceback", "\x00"):
        if word in said:
            raise Damage(f"the message says {word!r}: {said[-300:]}")
    if len(lines[0]) > 1500:
        raise Damage(f"a message of {len(lines[0])} characters")
    return "refused"
