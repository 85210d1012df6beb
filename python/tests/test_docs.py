"""The examples of docs/python.md run, in their order."""

import inspect
import re
from pathlib import Path

import planagent
import pytest

PAGE = Path(__file__).parents[2] / "docs" / "python.md"


def test_the_examples_of_the_page_run(capsys):
    pytest.importorskip("pandas")
    pytest.importorskip("gymnasium")
    blocks = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(), re.DOTALL | re.MULTILINE)
    # The example with Ray needs a cluster and nuPlan's data; test_ray.py has others.
    blocks = [block for block in blocks if "planagent.ray" not in block]
    assert len(blocks) >= 4
    names = {}
    for block in blocks:
        exec(compile(block, str(PAGE), "exec"), names)
    assert set(names["results"].mean_scores()) == {
        (planner, challenge) for planner in ("pdm-closed", "straight") for challenge in ("nonreactive", "reactive")
    }
    assert "Ego: " in capsys.readouterr().out


def documented(module):
    """The public classes, functions and methods of a module with their names."""
    for name in module.__all__:
        value = getattr(module, name)
        if not callable(value):
            continue
        yield f"{module.__name__}.{name}", value
        if not inspect.isclass(value):
            continue
        for member, method in vars(value).items():
            method = getattr(method, "__func__", method)
            if not member.startswith("_") and inspect.isfunction(method):
                yield f"{module.__name__}.{name}.{member}", method


def test_each_public_function_has_an_example():
    pytest.importorskip("gymnasium")
    import planagent.envs

    without = [
        name
        for module in (planagent, planagent.envs)
        for name, value in documented(module)
        # Exceptions are raised, and environments of gymnasium have its methods.
        if not (inspect.isclass(value) and issubclass(value, BaseException)) and ">>>" not in (inspect.getdoc(value) or "")
    ]
    assert without == []
