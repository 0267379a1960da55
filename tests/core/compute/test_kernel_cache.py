"""What compiled kernels are kept by."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]


def test_a_kernel_is_compiled_anew_when_what_it_takes_from_other_files_changes(tmp_path):
    """An update that changes a constant, or a kernel that others call, must not go on with the old ones."""
    (tmp_path / "callee.py").write_text(
        "from grmm_core.compute.kernels import compiled\n\n\n@compiled()\ndef more(x: float) -> float:\n    return x + 1.0\n"
    )
    (tmp_path / "caller.py").write_text(
        "from callee import more\nfrom constants import FACTOR\n\nfrom grmm_core.compute.kernels import compiled\n\n\n"
        "@compiled()\ndef scaled(x: float) -> float:\n    return FACTOR * more(x)\n"
    )
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join((str(tmp_path), str(ROOT))), PYTHONDONTWRITEBYTECODE="1")
    environment.pop("NUMBA_CACHE_DIR", None)

    def result(factor: float) -> tuple[float, int]:
        (tmp_path / "constants.py").write_text(f"FACTOR = {factor}\n")
        program = "from caller import scaled; print(scaled(1.0), sum(scaled.stats.cache_hits.values()))"
        found = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True)
        value, hits = found.stdout.split()
        return float(value), int(hits)

    assert result(2.0) == (4.0, 0)
    assert result(2.0) == (4.0, 1)
    assert result(3.0) == (6.0, 0)
    callee = tmp_path / "callee.py"
    callee.write_text(callee.read_text().replace("x + 1.0", "x - 3.0"))
    assert result(3.0) == (-6.0, 0)
