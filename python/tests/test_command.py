"""The program in the package, and packages that are missing."""

import json
import os
import shutil
import subprocess
import sys

import planagent
import pytest


def program(*arguments, folder=None):
    return subprocess.run([sys.executable, "-m", "planagent", *arguments], capture_output=True, text=True, timeout=100, cwd=folder)


def test_the_package_has_the_program(tmp_path):
    version = program("--version")
    assert version.returncode == 0 and planagent.__version__ in version.stdout
    run = program("simulate", "--scenario", "generated/changing_lane/2", "--planner", "idm", "--out", "run", "--json", folder=tmp_path)
    assert run.returncode == 0, run.stderr
    assert json.loads(run.stdout)["scenarios"][0]["planner"] == "idm"
    assert planagent.open_run(tmp_path / "run")[0]["planner"] == "idm"
    rows = program("simulate", "--resume", "run", "--csv", folder=tmp_path)
    columns = set(rows.stdout.splitlines()[0].split(",")) - {"zeroed_by"}
    assert columns <= set(planagent.open_run(tmp_path / "run").table().columns), columns
    wrong = program("simulate", "--planner", "nobody", folder=tmp_path)
    assert wrong.returncode == 2 and "nobody" in wrong.stderr
    assert program("--no-such-option").returncode == 2


def test_model_files_are_tried_by_the_interpreter(tmp_path):
    quantized = program("models", "quantize", "nano", "--to", "q8_0", "--out", "mine.gguf", folder=tmp_path)
    assert quantized.returncode == 0, quantized.stderr
    # Verdicts of former trials do not count.
    cache = {**os.environ, "PLANAGENT_CACHE": str(tmp_path / "cache")}
    check = [sys.executable, "-m", "planagent", "models", "check", "mine.gguf"]
    checked = subprocess.run(check, capture_output=True, text=True, timeout=100, cwd=tmp_path, env=cache)
    assert checked.returncode == 0, checked.stdout + checked.stderr
    ask = f"import planagent; print(planagent.Model({str(tmp_path / 'mine.gguf')!r}).ask(None, 'x', choices=['a', 'b']))"
    shutil.rmtree(tmp_path / "cache")
    asked = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True, timeout=100, env=cache)
    assert asked.stdout.strip() in ("a", "b"), asked.stderr


def test_the_learned_planners_are_there():
    assert {"plantf", "pdm-open", "dtpp"} <= set(planagent.planners())


@pytest.mark.parametrize(
    ("package", "use"),
    [
        ("gymnasium", "import planagent.envs"),
        ("ray", "import planagent.ray"),
        ("pandas", "planagent.simulate(S, 'simple').table().to_pandas()"),
        ("pyarrow", "planagent.simulate(S, 'simple').table().to_pyarrow()"),
        ("matplotlib", "planagent.simulate(S, 'simple').plot()"),
        ("nuplan", "import planagent.nuplan"),
    ],
)
def test_a_missing_package_is_named_with_how_to_install_it(package, use):
    lines = [
        "import sys, planagent",
        f"sys.modules[{package!r}] = None",
        "S = 'generated/changing_lane/2'",
        f"try: {use}",
        "except ModuleNotFoundError as error: print(error, isinstance(error, planagent.PlanAgentError))",
    ]
    shown = subprocess.run([sys.executable, "-c", "\n".join(lines)], capture_output=True, text=True, timeout=100, check=True)
    assert f"needs {package}, which is not installed: " in shown.stdout and shown.stdout.endswith("True\n")
    assert "pip install " in shown.stdout.partition("not installed: ")[2]
