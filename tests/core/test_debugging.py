"""With NUMBA_DISABLE_JIT=1 every kernel runs as Python, and says what it says when compiled."""

import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from navgym.core import compile as _compile
from tests.core.every_kernel import numbers

ROOT = Path(__file__).resolve().parents[2]
LANE = np.dtype([("x", float, (2,)), ("T", float, (2, 2)), ("k", int), ("inner", [("y", float)])])


@pytest.fixture(scope="module")
def interpreted(tmp_path_factory):
    """What every kernel says in a process that compiles nothing."""
    file = tmp_path_factory.mktemp("interpreted") / "numbers.npz"
    subprocess.run(
        [sys.executable, "-m", "tests.core.every_kernel", str(file)],
        check=True, cwd=ROOT, env=os.environ | {"NUMBA_DISABLE_JIT": "1"}, timeout=300,
    )  # fmt: skip
    return dict(np.load(file))


def test_no_kernel_is_left_out(interpreted):
    assert not list(interpreted["missing"])


def test_the_numbers_are_those_of_compiled_kernels(interpreted):
    compiled = numbers()
    assert set(interpreted) == {"missing", *compiled}
    for name, wanted in compiled.items():
        size = np.abs(wanted[np.isfinite(wanted)]).max(initial=0.0)
        np.testing.assert_allclose(
            interpreted[name], wanted, rtol=1e-12, atol=1e-12 * size, err_msg=name
        )


def test_fields_of_a_record_are_read_and_written_in_place():
    lanes = np.zeros((3, 2), LANE)
    seen = _compile._seen(lanes)
    assert seen.shape == (3, 2)
    assert len(seen[1:]) == 2
    lane = seen[1:][0, 1]
    lane.k = 3
    lane.k += 1
    lane.x[:] = 5.0
    lane.T[0, 1] = 6.0
    lane.inner.y = 7.0
    assert (lanes[1, 1]["k"], *lanes[1, 1]["x"]) == (4, 5.0, 5.0)
    assert (lanes[1, 1]["T"][0, 1], lanes[1, 1]["inner"]["y"]) == (6.0, 7.0)
    seen[0, 0] = lane
    assert lanes[0, 0] == lanes[1, 1]
    lane.k = 9
    assert lanes[0, 0]["k"] == 4


def test_a_record_shows_its_fields_and_refuses_others():
    lane = _compile._seen(np.zeros(1, LANE)[0])
    assert dir(lane) == sorted(LANE.names)
    assert repr(lane).splitlines()[-2:] == [
        "k = np.int64(0)",
        "inner = np.void((0.0,), dtype=[('y', '<f8')])",
    ]
    assert not hasattr(lane, "kk")
    with pytest.raises(ValueError, match="kk"):
        lane.kk = 3


def test_arithmetic_answers_as_compiled_code_where_python_raises():
    kernel_math = _compile._kernel_math()
    with np.errstate(all="ignore"):
        assert math.isnan(kernel_math.sqrt(-1.0))
        assert kernel_math.log(0.0) == -math.inf
        assert kernel_math.exp(1e3) == math.inf
        assert math.isnan(kernel_math.floor(math.nan))
        assert 1.0 / kernel_math.sqrt(0.0) == math.inf
        assert 1.0 / _compile._seen(0.0) == math.inf
    assert kernel_math.log1p(0.3) == math.log1p(0.3)
    assert kernel_math.pi == math.pi


def test_kernels_take_what_they_take_when_compiled(tmp_path):
    """A record alone, and the machine code that an environment enters without a check of types."""
    (tmp_path / "some.py").write_text(
        "import numpy as np\n"
        "from navgym.core.compile import entry, inline, kernel, part\n"
        "@inline\ndef twice(x):\n    return 2.0 * x\n"
        "@part\ndef move(lane):\n    lane.x += 1.0\n"
        "@kernel\ndef run(lane):\n    move(lane)\n    return twice(lane.x)\n"
        "lanes = np.zeros(2, [('x', float)])\n"
        "print(run(lane=lanes[1]), entry(run, (lanes[1],))(lanes[1]), lanes['x'])\n"
    )
    found = {
        off: subprocess.run(
            [sys.executable, "some.py"], check=True, cwd=tmp_path, capture_output=True, text=True,
            env=os.environ | {"NUMBA_DISABLE_JIT": off, "PYTHONPATH": str(ROOT)},
        ).stdout
        for off in "01"
    }  # fmt: skip
    assert found["0"] == found["1"] == "2.0 4.0 [0. 2.]\n"
