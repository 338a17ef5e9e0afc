"""The stubs say what there is."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import sutura
from conftest import ROOT


def test_all_that_is_exported_is_there_and_documented():
    for name in sutura.__all__:
        each = getattr(sutura, name)
        assert name == "__version__" or each.__doc__, name
    assert (Path(sutura.__file__).parent / "py.typed").is_file()


@pytest.mark.full
def test_the_stubs_agree_with_the_library(tmp_path):
    allowed = tmp_path / "allowed"
    allowed.write_text("sutura._sutura.__all__\n")
    tool = [sys.executable, "-m", "mypy.stubtest", "sutura", "--allowlist", str(allowed), "--ignore-unused-allowlist"]
    ran = subprocess.run(tool, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stdout + ran.stderr


@pytest.mark.full
def test_the_package_and_its_use_pass_a_type_checker(tmp_path):
    shutil.copytree(ROOT / "python/package/sutura", tmp_path / "sutura")
    ran = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "sutura"], cwd=tmp_path, capture_output=True, text=True
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr
