"""Same seed, same numbers: in several processes, and on the first run after an installation."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from bayes_sensor.cli import exit_code

EVALUATE = """
import numpy as np
from tests.support.campaigns import small_problem
from bayes_sensor.likelihood.mesh import compress
problem, theta = small_problem(n=2, interval=0.02)
mesh = compress(problem, theta)
rng = np.random.default_rng(1)
for _ in range(40):
    print(mesh.log_likelihood(theta * (1 + 1e-3 * rng.standard_normal(len(theta)))).hex())
"""


@pytest.mark.slow
def test_first_runs_which_compile_give_the_numbers_of_every_later_one(tmp_path: Path) -> None:
    # at once: what one process has cached may be called by what another has
    environment = {
        **os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "OMP_NUM_THREADS": "1",
        "PYTHONPATH": os.pathsep.join([str(Path(__file__).parents[2]), *sys.path]),
    }  # fmt: skip
    said = []
    for n in (3, 1):
        processes = [
            subprocess.Popen(
                [sys.executable, "-c", EVALUATE], env=environment, text=True,
                stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            )
            for _ in range(n)
        ]  # fmt: skip
        for process in processes:
            text, error = process.communicate()
            assert process.returncode == 0, error
            said.append(text)
    assert said[0].count("\n") == 40 and set(said) == {said[0]}


@pytest.mark.slow
def test_the_diagnosis_of_the_gap_does_not_depend_on_jobs(tmp_path: Path) -> None:
    small = ["--experiments", "1,6", "--duration", "12 s", "--interval", "20 ms", "--quiet"]
    noise = ["--sigma0", "5 mV", "--sigma1", "3 mV", "--effect", "valve_asymmetry=0.3"]
    campaign = tmp_path / "c" / "campaign.toml"
    assert exit_code(["simulate", "--out", str(campaign.parent), *small, *noise]) == 0
    texts = []
    for jobs in ("1", "2"):
        out = tmp_path / jobs
        options = ["--jobs", jobs, "--bootstrap", "4", "--seed", "3", "--quiet"]
        assert exit_code(["gap", str(campaign), "--out", str(out), *options]) == 0
        texts.append((out / "gap.json").read_text())
    assert texts[0] == texts[1]
