"""Cached kernels are loaded without numba's compiler, which is still there for whatever has to be compiled."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from nav_pose_estimator.core.numerics import jit

REPOSITORY = Path(__file__).resolve().parents[2]
INNER = """import numpy as np
from nav_pose_estimator.core.numerics.jit import inlined, kernel

@inlined
def square(x):
    return x * x

@kernel
def scaled(values, factor):
    if factor == 0.0:
        raise ValueError("no factor")
    out = np.empty_like(values)
    for i in range(len(values)):
        out[i] = factor * square(values[i])
    return out, len(values)

@kernel
def mean(values):
    return values.mean()
"""
USER = """import sys
import numpy as np
from inner import mean, scaled

print(mean(np.array((1.0, 2.0))), "scipy.linalg" in sys.modules)
print(scaled(np.array((1.0, 2.0, 3.0)), 2.0))
try:
    scaled(np.zeros(3), 0.0)
except ValueError as error:
    print(error)
print("hits", sum(scaled.stats.cache_hits.values()), "compiler", "numba.np.npyimpl" in sys.modules)
"""
COMPILES = """
from nav_pose_estimator.core.numerics.jit import kernel

@kernel
def outer(values):
    return scaled(values, 3.0)[0].sum() + scaled(values[::2], 1.0)[1]

print(outer(np.ones(3)), "hits", sum(outer.stats.cache_hits.values()))
"""
RESULTS = ["1.5 False", "(array([ 2.,  8., 18.]), 3)", "no factor"]
pytestmark = pytest.mark.compiled


def run(folder: Path, program: str, inner: str = INNER) -> list[str]:
    environment = os.environ | {"NUMBA_CACHE_DIR": str(folder / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
    environment["PYTHONPATH"] = os.pathsep.join([str(folder), str(REPOSITORY)])
    (folder / "inner.py").write_text(inner)
    (folder / "program.py").write_text(program)
    command = [sys.executable, "-c", "import program"]
    done = subprocess.run(command, env=environment, check=True, capture_output=True, text=True, timeout=300)
    return done.stdout.splitlines()


def test_a_cached_kernel_does_without_the_compiler(tmp_path):
    """GIVEN a kernel in the cache WHEN another process calls it THEN results and errors are the same, uncompiled."""
    assert run(tmp_path, USER) == [*RESULTS, "hits 0 compiler True"]
    assert run(tmp_path, USER) == [*RESULTS, "hits 1 compiler False"]


def test_a_new_kernel_is_compiled_with_cached_ones(tmp_path):
    """GIVEN a kernel loaded from the cache WHEN a new one calls it, also with other types THEN both are compiled."""
    run(tmp_path, USER)
    assert run(tmp_path, USER + COMPILES) == [*RESULTS, "hits 1 compiler False", "11.0 hits 0"]
    assert run(tmp_path, USER + COMPILES) == [*RESULTS, "hits 1 compiler False", "11.0 hits 1"]


@pytest.mark.parametrize("kind", ["nbi", "nbc"])
@pytest.mark.parametrize("length", [0, 60])
def test_a_file_cut_off_by_a_power_cut_is_compiled_again(tmp_path, kind, length):
    """GIVEN a file of the cache with only its first bytes WHEN a process starts THEN it compiles that kernel again."""
    run(tmp_path, USER)
    for path in tmp_path.rglob(f"inner.scaled*.{kind}"):
        path.write_bytes(path.read_bytes()[:length])
    assert run(tmp_path, USER) == [*RESULTS, "hits 0 compiler True"]
    assert run(tmp_path, USER) == [*RESULTS, "hits 1 compiler False"]


def test_an_index_never_names_machine_code_of_an_earlier_source(tmp_path):
    """GIVEN a changed kernel whose index is written WHEN the process ends there THEN the next one compiles it."""
    ends = (
        "import os\nfrom numba.core.caching import IndexDataCacheFile as File\nsave = File._save_data\n"
        "def save_or_end(self, name, data):\n"
        "    os._exit(0) if data and 'scaled' in name else save(self, name, data)\nFile._save_data = save_or_end\n"
    )
    run(tmp_path, USER)
    assert RESULTS[1] not in run(tmp_path, ends + USER, INNER.replace("factor *", "10.0 * factor *"))
    changed = run(tmp_path, USER, INNER.replace("factor *", "10.0 * factor *"))
    assert changed == [RESULTS[0], "(array([ 20.,  80., 180.]), 3)", RESULTS[2], "hits 0 compiler True"]


def test_a_full_disk_does_not_end_the_program(tmp_path):
    """GIVEN a disk that takes no file WHEN a kernel is compiled THEN it is used, with one warning."""
    full = (
        "import errno\nfrom numba.core.caching import IndexDataCacheFile as File\n"
        "def save(*_):\n    raise OSError(errno.ENOSPC, 'No space left on device')\nFile._save_index = save\n"
    )
    count = "import warnings\ncaught = warnings.catch_warnings(record=True)\ntold = caught.__enter__()\n"
    shown = 'print(len(told), "No space left" in str(told[0].message))\n'
    assert run(tmp_path, full + count + USER + shown) == [*RESULTS, "hits 0 compiler True", "1 True"]


def test_an_unknown_numba_loads_kernels_itself(tmp_path):
    """GIVEN kernels in the cache WHEN numba has a version that is not known THEN it loads them in its own way."""
    unknown = "import numba\nnumba.version_info = numba.version_info._replace(short=(999, 0))\n"
    run(tmp_path, USER)
    assert run(tmp_path, unknown + USER) == ["1.5 True", *RESULTS[1:], "hits 1 compiler True"]


def test_the_installed_numba_is_known():
    """A newer one is used in its own way, until the functions that ``kernel_cache`` replaces were compared."""
    assert jit.KernelCache is not None
