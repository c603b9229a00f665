"""The cache policy of compiled kernels: an edit of any file that a kernel reaches renames it."""

import numpy as np
import pytest

from navgym.core.compile import _content, _fingerprint, _kernel_files, kernel, part

KERNELS = "from navgym.core.compile import part\n"
IMPORTS = {
    "a name": "from navgym.inner.deep import helper\n",
    "a module": "from navgym.inner import deep\n",
    "a module under another name": "from navgym.inner import deep as d\n",
    "its full name": "import navgym.inner.deep as d\n",
    "several lines": "from navgym.inner import (\n    other,\n    deep,  # why\n)\n",
    "a line that goes on": "from navgym.inner import other, \\\n    deep\n",
    "by way of another": "from navgym.way import step\n",
}


@pytest.fixture
def package(tmp_path):
    """A package whose kernels in top.py reach inner/deep.py."""
    files = {
        "inner/deep.py": KERNELS,
        "inner/other.py": KERNELS,
        "way.py": KERNELS + IMPORTS["a name"],
        "plain.py": "A = 1\n",
    }
    folder = tmp_path / "navgym"
    (folder / "inner").mkdir(parents=True)
    for name, text in files.items():
        (folder / name).write_text(text)
    return folder


def fingerprint(package):
    for cached in (_fingerprint, _kernel_files, _content):
        cached.cache_clear()
    return _fingerprint(str(package / "top.py"), package)


def edit(file):
    file.write_text(file.read_text() + "\n# edited\n")


@pytest.mark.parametrize("how", IMPORTS)
def test_an_edit_of_an_imported_kernel_file_renames_a_kernel(package, how):
    text = f'"""About\nclass and def of things."""\n\n{KERNELS}{IMPORTS[how]}\n\n@part\ndef f():\n    1\n'
    (package / "top.py").write_text(text)
    before = fingerprint(package)
    edit(package / "inner" / "deep.py")
    assert fingerprint(package) != before


def test_an_edit_of_any_other_file_does_not(package):
    (package / "top.py").write_text(
        "import numpy as np\nfrom navgym.plain import A\nfrom navgym.inner.deep import helper\n"
    )
    before = fingerprint(package)
    for name in ("plain.py", "inner/other.py", "way.py"):
        edit(package / name)
    assert fingerprint(package) == before


def test_an_edit_of_constants_that_kernels_freeze_renames_a_kernel(package):
    (package / "plain.py").write_text('"""These are frozen into kernels."""\nA = 1\n')
    (package / "top.py").write_text(
        KERNELS + "from navgym.plain import A\n\n\n@part\ndef f():\n    A\n"
    )
    before = fingerprint(package)
    edit(package / "plain.py")
    assert fingerprint(package) != before


def test_a_package_of_ones_own_is_followed_too(tmp_path, package):
    mine = tmp_path / "mine" / "deeper"
    mine.mkdir(parents=True)
    for folder in (mine, mine.parent):
        (folder / "__init__.py").write_text("")
    (mine / "parts.py").write_text(KERNELS)
    (mine / "top.py").write_text(KERNELS + "from mine.deeper.parts import helper\n")

    def own():
        for cached in (_fingerprint, _kernel_files, _content):
            cached.cache_clear()
        return _fingerprint(str(mine / "top.py"), package)

    before = own()
    edit(mine / "parts.py")
    assert own() != before


@part
def twice(x):
    return 2.0 * x


@kernel
def plus_one(x):
    return twice(x) + 1.0


@kernel
def sum_of(numbers):
    total = 0.0
    for x in numbers:
        total += plus_one(x)
    return total


def test_a_kernel_calls_parts_and_other_kernels():
    assert sum_of(np.array([1.0, 2.0])) == 8.0
    assert plus_one(3.0) == 7.0


def test_only_what_python_calls_becomes_machine_code():
    sum_of.recompile()
    sum_of(np.array([1.0, 2.0]))
    parts = [found for f in (twice, plus_one._part) for found in f.overloads.values()]
    assert len(parts) == 2
    engine = parts[0].library.codegen._engine
    assert [engine.get_function_address(p.fndesc.mangled_name) for p in parts] == [0, 0]
    assert all(
        engine.get_function_address(k.fndesc.mangled_name) for k in sum_of.overloads.values()
    )


def test_a_part_called_by_python_says_what_it_is():
    with pytest.raises(TypeError, match="twice is part of kernels"):
        twice(1.0)
