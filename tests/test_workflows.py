"""Workflows of GitHub Actions."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.slow
def test_workflows_follow_the_schema_of_github_actions():
    paths = sorted(ROOT.glob(".github/workflows/*.yml"))
    command = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", "vendor.github-workflows"]
    done = subprocess.run([*command, *map(str, paths)], capture_output=True, text=True)
    assert len(paths) == 2 and done.returncode == 0, done.stdout + done.stderr
