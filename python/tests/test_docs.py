"""The examples of docs/python.md run, in their order."""

import re
from pathlib import Path

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
