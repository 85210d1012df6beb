"""Checks the modules, the loss and the augmentation against the numbers of the originals."""

import json
import sys
from pathlib import Path

import torch
from safetensors.torch import load_file

from . import dtpp, gameformer, gc_pgp, pdm_open, plantf, raster_model, urban_driver


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


def check_urban_driver(folder):
    model = urban_driver.Model(width=32, layers=2).eval()
    model.load_state_dict(load_file(folder / "urban_tiny.safetensors"))
    counts, kinds = (1, 6, 8, 8, 8, 3, 4, 6), (urban_driver.EGO, urban_driver.VEHICLE, *urban_driver.LAYERS)
    kinds = torch.cat([torch.full((count,), kind) for count, kind in zip(counts, kinds)])
    for source in ("random", "scene_a", "scene_b"):
        file = load_file(folder / f"urban_tiny.{source}.io.safetensors")
        available = file["mid.availability"].bool()
        found = model.plan(file["mid.elements"], available, kinds.expand(len(available), -1))
        close(f"urban-driver {source}", found, file["out.trajectory"])


def check_raster_model(folder):
    model = raster_model.Model((4, 8, 16, 32)).eval()
    model.load_state_dict(load_file(folder / "raster_model_tiny.safetensors"))
    file = load_file(folder / "raster_model_tiny.io.safetensors")
    raster = file["random64.in.raster_times_2"]
    close("raster-model", model({"raster": raster}), file["random64.out.trajectory"])


def actors_batch(file):
    names = {"ego": "ego_agent_past", "neighbors": "neighbor_agents_past", "lanes": "map_lanes", "route": "route_lanes"}
    names |= {"crosswalks": "map_crosswalks", "tree": "tree"}
    return {name: file[f"in.{theirs}"] for name, theirs in names.items() if f"in.{theirs}" in file}


def check_gameformer(folder):
    model = gameformer.Model(dim=16, layers=2, levels=2, modes=3, neighbors=4).eval()
    model.load_state_dict(load_file(folder / "gameformer_tiny.safetensors"))
    file = load_file(folder / "gameformer_tiny.random.io.safetensors")
    levels, plan = model(actors_batch(file))
    close("gameformer plan", plan, file["out.ego_plan"])
    for i, (futures, scores) in enumerate(levels):
        close(f"gameformer level {i}", futures, file[f"out.level_{i}_interactions"])
        close(f"gameformer scores {i}", scores, file[f"out.level_{i}_scores"])
    file = load_file(folder / "gameformer_loss.io.safetensors")
    levels = [(file[f"in.level_{i}_interactions"], file[f"in.level_{i}_scores"]) for i in range(3)]
    agents, ego = file["in.neighbors_future"], file["in.ego_future"]
    target, valid = torch.cat([ego[:, None], agents], 1), (agents[..., 0] != 0).float()
    total = sum(gameformer.level_loss(*level, target, valid) for level in levels)
    close("gameformer level loss", total[None], file["out.level_k_loss"])


def check_dtpp(folder):
    model = dtpp.Model(dim=16, inner=4, layers=2, neighbors=4, branches=6).eval()
    model.load_state_dict(load_file(folder / "dtpp_tiny.safetensors"))
    for steps in (30, 80):
        file = load_file(folder / f"dtpp_tiny.random_b1_t{steps}.io.safetensors")
        batch = actors_batch(file)
        [(futures, scores, ego, weights)] = model(batch, stages=(("tree", steps),))
        close(f"dtpp futures {steps}", futures, file["out.agent_trajectories"])
        close(f"dtpp scores {steps}", scores.clamp(min=-1e9), file["out.scores"].clamp(min=-1e9))
        close(f"dtpp ego {steps}", ego, file["out.ego_regularization"])
        close(f"dtpp weights {steps}", weights, file["out.weights"])
    file = load_file(folder / "dtpp_loss.io.safetensors")
    given = lambda name: file[f"in.{name}"]
    agents = given("neighbors_gt")
    arguments = [given(name) for name in ("neighbors", "ego_tree", "ego_regularization", "scores", "weights", "ego_gt")]
    close("dtpp loss", dtpp.stage_loss(*arguments, agents, (agents != 0).float())[None], file["out.loss"])


def check_gc_pgp(folder):
    model = gc_pgp.Model().eval()
    model.load_state_dict(load_file(folder / "gc_pgp_full.safetensors"))
    file = load_file(folder / "gc_pgp_full.batch2.io.safetensors")
    given = lambda name: file[f"in.{name}"]
    edges = given("edge_type")[..., :-1].long()
    batch = {
        "ego": given("ego_feats")[:, 0],
        "agent.step": given("vehicle_agent_feats"),
        "agent.seen": 1 - given("vehicle_agent_masks")[..., 0],
        # In the original, agents that only fill a batch are heard.
        "far": given("vehicle_node_masks"),
        "agent.present": torch.ones(given("vehicle_agent_feats").shape[:2], dtype=torch.bool),
        "map.pose": given("lane_node_feats"),
        "map.length": (1 - given("lane_node_masks")[..., 0]).sum(-1),
        "map.red": given("red_light_flag")[:, :, 0, 0],
        "map.successor": given("s_next")[..., :-1],
        "map.edge": edges,
    }
    ego, nodes = model.encoder(batch)
    close("gc-pgp ego", ego, file["enc.target_agent"])
    close("gc-pgp nodes", nodes, file["enc.nodes"])
    close("gc-pgp policy", model.aggregator.policy(ego, nodes, batch), file["policy.pi_without_route_mask"])
    walks = torch.stack([torch.tensor(sorted(sample.tolist())) for sample in file["aggregator.in.traversals"]])
    contexts = model.aggregator.contexts(ego, nodes, walks)
    close("gc-pgp contexts", contexts, file["aggregator.out"])
    close("gc-pgp trajectories", model.decoder(contexts, file["decoder.in.z"]), file["decoder.out.traj_all"])


def check(folder):
    folder = Path(folder)
    with torch.no_grad():
        check_pdm_open(folder / "pdm")
        check_plantf(folder / "plantf")
        check_plantf_training(folder / "plantf")
        check_urban_driver(folder / "urban_driver")
        check_raster_model(folder / "raster")
        check_gameformer(folder / "gameformer")
        check_dtpp(folder / "dtpp")
        check_gc_pgp(folder / "gc_pgp")
