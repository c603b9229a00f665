"""Compiled kernels on disk: nobody else's pickles are loaded, damage heals, a full disk costs the cache.

Each test is a process of its own with a small kernel and a cache folder of its own.
"""

import os
import pickle
import resource
import subprocess
import sys

import pytest

from navgym.core.kernel_cache import unsafe

posix = pytest.mark.skipif(os.name != "posix", reason="permissions of POSIX")

MODULE = """
from navgym.core.compile import kernel

@kernel
def twice(x):
    return 2.0 * x

@kernel
def eight_times(x):
    return twice(twice(twice(x)))
"""


USE = "print(small.twice(small.eight_times(1.5)))"


class Place:
    """A module with kernels, a cache folder, and what a process with both prints."""

    def __init__(self, folder):
        self.folder, self.home, self.cache = folder, folder / "home", folder / "cache"
        self.home.mkdir()
        (folder / "mine").mkdir()
        (folder / "mine" / "small.py").write_text(MODULE)

    def run(self, cache=True, code=USE, room=None, umask=-1, **more):
        """What was said on standard error, after the right number on standard output."""
        kept = ("PATH", "SYSTEMROOT", "PYTHONDONTWRITEBYTECODE")
        env = {name: os.environ[name] for name in kept if name in os.environ}
        env |= {"HOME": str(self.home), "PYTHONPATH": str(self.folder / "mine")} | more
        if cache:
            env["NUMBA_CACHE_DIR"] = str(self.cache if cache is True else cache)
        words = [sys.executable, "-c", f"import small\n{code}"]
        limit = None if room is None else lambda: _full(room)
        found = subprocess.run(
            words,
            env=env,
            umask=umask,
            capture_output=True,
            text=True,
            preexec_fn=limit,
            check=False,
        )
        assert (found.returncode, found.stdout) == (0, "24.0\n"), found.stderr
        assert all(line.startswith("navgym: ") for line in found.stderr.splitlines())
        return found.stderr

    def files(self, kind, where=None):
        return sorted((where or self.cache).rglob(f"*.{kind}"))

    def all(self):
        return [path for path in self.cache.rglob("*") if path.is_file()]


def _full(room):
    """From `room` bytes on, a file's disk is full."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))


@pytest.fixture
def place(tmp_path):
    return Place(tmp_path)


def test_the_first_use_says_in_one_line_how_long_it_takes_and_later_ones_nothing(place):
    said = place.run()
    assert said.count("\n") == 1
    assert "compiling kernels for this machine, once: some 5 to 20 s per filter" in said
    assert len(place.files("nbc")) == 2
    assert place.run() == ""


def test_who_asks_for_quiet_gets_it(place):
    assert place.run(NAVGYM_QUIET="1") == ""
    for file in place.files("nbi"):
        file.unlink()
    assert "compiling" in place.run(NAVGYM_QUIET="0")


def test_workers_leave_the_line_to_their_parent(place):
    code = (
        "from concurrent.futures import ProcessPoolExecutor\n"
        "with ProcessPoolExecutor(2) as pool:\n"
        "    print(*set(pool.map(small.eight_times, [3.0, 3.0])))"
    )
    assert place.run(code=code) == ""


@posix
def test_a_standard_error_that_cannot_be_written_is_no_fault(place):
    lost = ["os.close(2)", "sys.stderr.close()", "os.dup2(os.open('/dev/full', 1), 2)"]
    for number, stream in enumerate(lost):
        place.run(cache=place.folder / f"{number}", code=f"import os, sys; {stream}; {USE}")


def test_damaged_files_heal(place):
    place.run()
    damages = [
        ("nbi", lambda b: b""), ("nbi", lambda b: b[:-7]),
        ("nbc", lambda b: b[:40]), ("nbc", lambda b: bytes(len(b))),
    ]  # fmt: skip
    for kind, damage in damages:
        for file in place.files(kind):
            file.write_bytes(damage(file.read_bytes()))
        said = place.run()
        assert said.count("\n") == 1
        assert "is not used but made anew" in said
    assert place.run() == ""


def test_a_full_disk_costs_the_cache_and_not_the_run(place):
    said = place.run(room=0)
    assert said.count("\n") == 2
    assert "cannot be kept in " in said
    assert "(File too large): going on without, it compiles again next time" in said
    assert not [f for f in place.all() if f.stat().st_size]
    place.run()
    assert place.run() == ""


def test_an_index_without_its_code_names_no_other_code(place):
    # room for the index, not for the code: code of that name may be left from another time
    place.run()
    index, code = place.files("nbi"), place.files("nbc")
    sizes = [f.stat().st_size for f in index + code]
    room = (max(sizes[:2]) + min(sizes[2:])) // 2
    for file in index:
        file.unlink()
    place.run(room=room)
    assert place.all() == []


# ---- whose files


class Foreign:
    """A pickle that leaves a trace where it is loaded."""

    def __init__(self, trace):
        self.trace = trace

    def __reduce__(self):
        return os.mkdir, (str(self.trace),)


def forge(place, where=None):
    """Others' code in every file of the cache."""
    trace = place.folder / "foreign code ran"
    for kind in ("nbi", "nbc"):
        assert place.files(kind, where)
        for file in place.files(kind, where):
            file.write_bytes(pickle.dumps(Foreign(trace)))
    return trace


def test_the_forgery_works_where_it_is_the_users_own(place):
    place.run()
    trace = forge(place)
    place.run()
    assert trace.exists()


@posix
def test_a_folder_that_others_can_write_to_is_passed_over_with_a_line(place):
    place.run()
    trace = forge(place)
    (package,) = place.cache.iterdir()
    for shared, mode in [(place.cache, 0o777), (place.cache, 0o757), (package, 0o1777)]:
        before = shared.stat().st_mode
        shared.chmod(mode)
        said = place.run()
        assert "NUMBA_CACHE_DIR is not used (others can write to " in said
        assert (
            "set NUMBA_CACHE_DIR to a folder that only you can write to, such as ~/.cache" in said
        )
        shared.chmod(before)
        assert not trace.exists()
    assert said.count("\n") == 1  # no word of compiling: the next folder has it by now


@posix
def test_where_others_can_swap_a_folder_above_nothing_below_it_is_used(place):
    place.run()
    trace = forge(place)
    place.folder.chmod(0o777)
    assert "compiled kernels cannot be kept" in place.run()
    assert not trace.exists()


@posix
def test_a_file_that_others_can_write_is_made_anew(place):
    place.run()
    trace = forge(place)
    for file in place.files("nbi"):
        file.chmod(0o666)
    assert "others can write to" in place.run()
    assert not trace.exists()
    assert place.run() == ""


@posix
def test_where_no_folder_will_do_kernels_compile_in_memory_with_a_line(place):
    for folder in (place.home, place.folder / "mine"):
        folder.chmod(0o777)
    for _ in range(2):
        said = place.run(cache=False)
        assert said.count("\n") == 1
        assert "compiled kernels cannot be kept" in said
        assert "set NUMBA_CACHE_DIR to a folder that only you can write to" in said
    assert not place.files("nbi", place.folder)


@posix
def test_without_a_wish_the_folder_beside_the_source_comes_before_the_users_own(place):
    place.run(cache=False)
    assert len(place.files("nbi", place.folder / "mine" / "__pycache__")) == 2
    trace = forge(place, place.folder / "mine")
    (place.folder / "mine" / "__pycache__").chmod(0o777)
    assert "compiling" in place.run(cache=False)
    assert not trace.exists()
    assert len(place.files("nbi", place.home)) == 2


@posix
def test_a_folder_that_cannot_be_made_is_passed_over(place):
    (place.folder / "file").touch()
    said = place.run(cache=place.folder / "file" / "cache")
    assert "NUMBA_CACHE_DIR is not used" in said
    assert "Not a directory" in said


@posix
def test_what_is_made_is_the_users_alone_whatever_the_umask(place):
    place.run(umask=0)
    assert {path.stat().st_mode & 0o022 for path in place.cache.rglob("*")} == {0}
    assert place.run() == ""


@posix
def test_a_sticky_folder_above_is_safe_and_one_that_is_not_is_not(tmp_path):
    (tmp_path / "shared" / "own").mkdir(parents=True)
    for mode, safe in [(0o1777, True), (0o777, False)]:
        (tmp_path / "shared").chmod(mode)
        unsafe.cache_clear()
        assert (unsafe(str(tmp_path / "shared" / "own")) == "") is safe


@pytest.mark.skipif(os.name != "posix" or os.geteuid() != 0, reason="only root gives files away")
@pytest.mark.parametrize("given", ["shared/theirs", "shared/theirs/own", "shared/link"])
def test_what_another_user_owns_or_could_swap_is_unsafe(tmp_path, given):
    shared, own = tmp_path / "shared", tmp_path / "shared" / "theirs" / "own"
    own.mkdir(parents=True)
    (tmp_path / "safe").mkdir()
    (shared / "link").symlink_to(tmp_path / "safe")
    shared.chmod(0o1777)
    assert unsafe(str(tmp_path / "shared" / "link" / "..")) == ""
    os.chown(own.parent, 1234, 1234)
    os.chown(shared / "link", 1234, 1234, follow_symlinks=False)
    unsafe.cache_clear()
    assert "belongs to another user (number 1234)" in unsafe(str(tmp_path / given))
