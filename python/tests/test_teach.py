"""TRL trains a tiny model by the simulator's reward."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MODEL = ROOT / "tests" / "fixtures" / "tiny_lora" / "base"


def test_grpo_takes_ten_steps_by_the_reward(tmp_path):
    pytest.importorskip("trl")
    pytest.importorskip("peft")
    data, adapter = tmp_path / "data", tmp_path / "adapter"
    command = [sys.executable, "-m", "planagent", "dataset", "--for", "messages", "--out", str(data), "--quiet", "--trust-model"]
    subprocess.run([*command, "--states", "1", "--validation", "0", "--model", str(MODEL), "--prompt-set", "compact"], check=True)
    example = [sys.executable, str(ROOT / "examples" / "teach" / "train.py"), "grpo", "--data", str(data), "--model", str(MODEL)]
    options = ["--out", str(adapter), "--steps", "10", "--batch", "2", "--cpu"]
    subprocess.run([*example, *options], check=True, env={**os.environ, "HF_HUB_OFFLINE": "1"})
    assert (adapter / "adapter_model.safetensors").is_file()
