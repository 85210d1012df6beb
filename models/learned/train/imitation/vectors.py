"""Checks the modules, the loss and the augmentation against the numbers of the originals."""

import json
import sys
from pathlib import Path

import torch
from safetensors.torch import load_file

from . import pdm_open, plantf


def close(what, found, expected, tolerance=1e-4):
    deviation = ((found - expected).abs() / (1 + expected.abs())).max().item()
    print(f"{what}: worst deviation {deviation:.1e}", file=sys.stderr)
    assert deviation <= tolerance, what


def check_pdm_open(folder):
    model = pdm_open.Model(hidden=32).eval()
    model.load_state_dict(load_file(folder / "pdm_open_tiny.safetensors"))
    file = load_file(folder / "pdm_open_tiny.io.safetensors")
    names = {"position": "ego_position", "velocity": "ego_velocity", "acceleration": "ego_acceleration", "centerline": "planner_centerline"}
    for source in ("random", "scene_a", "scene_b"):
        batch = {name: file[f"{source}.in.{theirs}"] for name, theirs in names.items()}
        close(f"pdm-open {source}", model(batch), file[f"{source}.out.trajectory"])


def plantf_batch(file):
    renamed = {"polygon_type": "kind", "polygon_tl_status": "light", "polygon_on_route": "on_route"}
    renamed |= {"polygon_speed_limit": "speed_limit", "polygon_has_speed_limit": "has_speed_limit", "valid_mask": "valid"}
    batch = {"current_state": file["in.current_state"]}
    for name in ("position", "heading", "velocity", "shape", "category"):
        batch[f"agent.{name}"] = file[f"in.agent.{name}"]
    batch["agent.valid"] = file["in.agent.valid_mask"]
    for name in ("position", "vector", "orientation"):
        batch["map.point" if name == "position" else f"map.{name}"] = file[f"in.map.point_{name}"][:, :, 0]
    for theirs, name in renamed.items():
        batch[f"map.{name}"] = file[f"in.map.{theirs}"]
    return batch


def check_plantf(folder):
    model = plantf.Model(dim=32, depth=2, heads=4, modes=3).eval()
    model.load_state_dict(load_file(folder / "plantf_tiny.safetensors"))
    for source in ("scene_a", "scene_b"):
        file = load_file(folder / f"plantf_tiny.{source}.io.safetensors")
        for name, found in zip(("trajectory", "probability", "prediction"), model(plantf_batch(file))):
            close(f"plantf {source} {name}", found, file[f"out.{name}"])


def check_plantf_training(folder):
    file = load_file(folder / "plantf_loss.io.safetensors")
    target, valid = file["in.target"], file["in.valid_mask"][:, :, -plantf.POSES :]
    given = lambda batch: (file["in.trajectory"], file["in.probability"], file["in.prediction"])
    batch = {"target": target[:, 0], "agent.target": target, "agent.target_valid": valid}
    close("plantf loss", plantf.loss(given, batch)[None], file["out.loss"])
    cases = json.loads((folder / "training_cases.json").read_text())
    rates = torch.tensor([plantf.RATE * plantf.learning_rate(epoch, plantf.EPOCHS) for epoch in range(plantf.EPOCHS)])
    close("plantf learning rate", 1e3 * rates, 1e3 * torch.tensor(cases["lr_per_epoch"]))
    for case in cases["collision_check"]:
        pose, other = (torch.tensor(case[name], dtype=torch.float32) for name in ("ego_center_pose", "object_pose"))
        size = lambda value: torch.tensor(float(value))
        ego = plantf.corners(pose[:2], pose[2], size(plantf.LENGTH), size(plantf.WIDTH))
        box = plantf.corners(other[:2], other[2], size(case["length"]), size(case["width"]))
        expected = next(value for key, value in case.items() if key.startswith("coll"))
        assert bool(plantf.overlap(ego, box)) == bool(expected), case
    print("plantf collisions: as expected", file=sys.stderr)


def check(folder):
    folder = Path(folder)
    with torch.no_grad():
        check_pdm_open(folder / "pdm")
        check_plantf(folder / "plantf")
        check_plantf_training(folder / "plantf")
