"""Trains every planner for some steps on made-up samples in small shapes, and writes checkpoints with inputs and outputs, which the
tests of the program compare with its own outputs."""

import argparse
import sys
from pathlib import Path

import torch
from safetensors.torch import save_file

from . import dtpp, gameformer, gc_pgp, pdm_open, plantf, raster_model, shards, urban_driver
from .training import save, train

# Sizes of elements in the inputs of UrbanDriver: ego, vehicles, layers.
ELEMENTS = (1, 6, 8, 8, 8, 3, 4, 6)


class Made:
    """A source of made-up tensors."""

    def __init__(self):
        self.generator = torch.Generator().manual_seed(1)

    def normal(self, *shape):
        return torch.randn(*shape, generator=self.generator)

    def speeds(self, count, poses, step):
        """Speeds (B), and the poses of a driver who keeps them."""
        speed = 10 * torch.rand(count, generator=self.generator)
        times = step * torch.arange(1, poses + 1)
        places = speed[:, None] * times
        return speed, torch.stack([places, 0 * places, 0 * places], -1)


def ones(*shape):
    return torch.ones(shape, dtype=torch.uint8)


def pdm_open_samples(made, count=256):
    speed, target = made.speeds(count, 16, 0.5)
    velocity = 0.1 * made.normal(count, 11, 3)
    velocity[:, :, 0] = speed[:, None]
    history = {"position": made.normal(count, 11, 3), "velocity": velocity, "acceleration": made.normal(count, 11, 3)}
    return shards.Flat({**history, "centerline": made.normal(count, 120, 3), "target": target})


def plantf_samples(made, count=256, agents=3, polygons=4):
    speed, target = made.speeds(count, 80, 0.1)
    rows, areas = count * agents, count * polygons
    state = torch.cat([torch.zeros(count, 3), speed[:, None], 0.1 * made.normal(count, 3)], 1)
    position, heading = made.normal(rows, 21, 2) * 30, made.normal(rows, 21)
    # The first agent is the ego; it is at the origin now.
    position[::agents, -1], heading[::agents, -1] = 0, 0
    return shards.Ragged(
        {
            "target": target,
            "current_state": state,
            "agents": torch.full((count,), agents, dtype=torch.uint8),
            "polygons": torch.full((count,), float(polygons)),
            "agent.position": position,
            "agent.heading": heading,
            "agent.velocity": made.normal(rows, 21, 2),
            "agent.shape": ones(rows, 21, 2).float() * 2,
            "agent.valid": ones(rows, 21),
            "agent.category": ones(rows),
            "agent.target": made.normal(rows, 80, 3),
            "agent.target_valid": ones(rows, 80),
            "map.point": made.normal(areas, 20, 2) * 30,
            "map.vector": made.normal(areas, 20, 2),
            "map.orientation": made.normal(areas, 20),
            "map.speed_limit": ones(areas).float() * 10,
            "map.has_speed_limit": ones(areas),
            "map.kind": ones(areas),
            "map.on_route": ones(areas),
            "map.light": ones(areas) * 3,
            "map.valid": ones(areas, 20),
        }
    )


def urban_driver_samples(made, count=128, agents=3, polygons=5):
    speed, target = made.speeds(count, 16, 0.5)
    times = urban_driver.FRAME_S * torch.arange(-4, 1)
    places = speed[:, None] * times
    rows, lines = count * agents, count * polygons
    return shards.Ragged(
        {
            "target": target,
            "speed": speed,
            "ego": torch.stack([places, 0 * places, 0 * places], -1),
            "agents": torch.full((count,), agents, dtype=torch.uint8),
            "polygons": torch.full((count,), float(polygons)),
            "agent.frame": made.normal(rows, 5, 8),
            "map.point": made.normal(lines, 20, 6),
            "map.available": ones(lines, 20),
            "map.layer": torch.arange(lines).remainder(6).to(torch.uint8),
        }
    )


def raster_model_samples(made, count=64):
    speed, target = made.speeds(count, 16, 0.5)
    raster = torch.zeros(count, 4, 64, 64, dtype=torch.uint8)
    for sample, length in zip(raster, (5 * speed).long()):
        sample[1, 32 : 33 + int(length) // 2] = 2
    return shards.Flat({"target": target, "speed": speed, "raster": raster})


def gc_pgp_samples(made, count=96, agents=2, nodes=6):
    speed, target = made.speeds(count, 16, 0.5)
    steps = 0.2 * torch.arange(-5, 1)
    ego = torch.zeros(count, 6, 5)
    ego[..., 0], ego[..., 2] = speed[:, None] * steps, speed[:, None]
    poses = torch.zeros(count, nodes, 20, 7)
    poses[..., 0] = 20.0 * torch.arange(nodes)[:, None] + torch.arange(20)
    successor = torch.full((count, nodes, 16), -1.0)
    successor[:, :-1, 0] = torch.arange(1.0, nodes)
    edge = (successor >= 0).to(torch.uint8)
    last = (target[:, -1, 0] / 20).long().clamp(max=nodes - 1)
    visited = torch.zeros(count, nodes, 17, dtype=torch.uint8)
    traversal = torch.zeros(count, 16)
    for sample, end in enumerate(last.tolist()):
        visited[sample, :end, 0], visited[sample, end, 16] = 1, 1
        traversal[sample] = torch.tensor([min(i, nodes + end) if i <= end else nodes + end for i in range(16)]).float()
    return shards.Ragged(
        {
            "target": target,
            "speed": speed,
            "ego": ego,
            "traversal": traversal,
            "agents": torch.full((count,), agents, dtype=torch.uint8),
            "polygons": torch.full((count,), float(nodes)),
            "agent.step": 5 * made.normal(count * agents, 6, 5),
            "agent.seen": ones(count * agents, 6),
            "map.pose": poses.flatten(0, 1),
            "map.length": 20 * ones(count * nodes),
            "map.red": 0 * ones(count * nodes),
            "map.initial": (torch.arange(count * nodes) % nodes == 0).to(torch.uint8),
            "map.successor": successor.flatten(0, 1),
            "map.edge": edge.flatten(0, 1),
            "map.visited": visited.flatten(0, 1),
        }
    )


def actors(made, count):
    speed, target = made.speeds(count, 80, 0.1)
    ego = torch.zeros(count, 21, 7)
    ego[..., 0], ego[..., 3] = speed[:, None] * 0.1 * torch.arange(-20, 1), speed[:, None]
    neighbors = made.normal(count, 20, 21, 11)
    neighbors[:, 6:] = 0
    lanes, crosswalks = made.normal(count, 40, 50, 7), made.normal(count, 5, 30, 3)
    lanes[:, 8:], crosswalks[:, 1:] = 0, 0
    futures = neighbors[:, :10, -1:, :3].repeat(1, 1, 80, 1)
    return {"target": target, "futures": futures, "ego": ego, "neighbors": neighbors, "lanes": lanes, "crosswalks": crosswalks}


def gameformer_samples(made, count=48):
    route = made.normal(count, 10, 50, 3)
    route[:, 4:] = 0
    return shards.Flat({**actors(made, count), "route": route})


def dtpp_samples(made, count=24):
    samples = actors(made, count)
    trees = []
    for steps in (30, 80):
        tree = torch.zeros(count, 30, 80, 6)
        speeds = samples["ego"][:, -1, 3][:, None] + torch.arange(12) * 0.7
        times = 0.1 * torch.arange(1, steps + 1)
        tree[:, :12, :steps, 0] = speeds[..., None] * times
        tree[:, :12, :steps, 3] = speeds[..., None]
        trees.append(tree)
    return shards.Flat({**samples, "first": trees[0], "second": trees[1]})


def named(prefix, tensors):
    return {f"{prefix}.{name}": tensor.detach().float().contiguous() for name, tensor in tensors.items()}


def pdm_open_io(model, batch):
    history = {name: batch[name] for name in ("position", "velocity", "acceleration", "centerline")}
    return {**named("in", history), **named("out", {"trajectory": model(batch)})}


def plantf_io(model, batch):
    lines = {name: batch[f"map.{name}"][:, :, None] for name in ("point", "vector", "orientation")}
    middle = batch["map.point"].shape[2] // 2
    center = torch.cat([batch["map.point"][:, :, middle], batch["map.orientation"][:, :, middle, None]], -1)
    given = {
        "current_state": batch["current_state"],
        **{f"agent.{name}": batch[f"agent.{name}"] for name in ("position", "heading", "velocity", "shape", "category")},
        "agent.valid_mask": batch["agent.valid"],
        "map.point_position": lines["point"],
        "map.point_vector": lines["vector"],
        "map.point_orientation": lines["orientation"],
        "map.polygon_center": center,
        "map.polygon_type": batch["map.kind"],
        "map.polygon_on_route": batch["map.on_route"],
        "map.polygon_tl_status": batch["map.light"],
        "map.polygon_speed_limit": batch["map.speed_limit"],
        "map.polygon_has_speed_limit": batch["map.has_speed_limit"],
        "map.valid_mask": batch["map.valid"],
    }
    return {**named("in", given), **named("out", dict(zip(("trajectory", "probability", "prediction"), model(batch))))}


def urban_driver_io(model, batch):
    made = Made()
    rows = sum(ELEMENTS)
    points, available = made.normal(2, rows, 20, 8), made.normal(2, rows, 20) > 0
    available[:, 0, :5] = True
    points = points * available[..., None]
    kinds = torch.cat([torch.full((count,), kind) for count, kind in zip(ELEMENTS, (0, 1, *urban_driver.LAYERS))])
    plan = model.plan(points, available, kinds.expand(2, -1))
    return {**named("in", {"points": points, "available": available}), **named("out", {"trajectory": plan})}


def raster_model_io(model, batch):
    return {**named("in", {"raster": batch["raster"] / 2}), **named("out", {"trajectory": model(batch)})}


def gc_pgp_io(model, batch, samples=20):
    ego, nodes = model.encoder(batch)
    policy = model.aggregator.policy(ego, nodes, batch)
    count = nodes.shape[1]
    torch.manual_seed(2)
    walks = gc_pgp.drawn(policy, batch, samples)
    # The program puts walks in order; so that rows belong to each other, they are given in order.
    walks = torch.stack([torch.tensor(sorted(sample.tolist())) for sample in walks])
    contexts = model.aggregator.contexts(ego, nodes, walks)
    latent = torch.randn(*contexts.shape[:2], gc_pgp.LATENT)
    edges = torch.cat([batch["map.edge"].float(), torch.full((len(ego), count, 1), 3.0)], 2)
    own = count + torch.arange(count).float()
    successors = torch.cat([batch["map.successor"].clamp(min=0), own[None, :, None].expand(len(ego), -1, 1)], 2)
    exists = torch.arange(20) < batch["map.length"].long()[..., None]
    given = {
        "ego": batch["ego"][:, None],
        "agents": batch["agent.step"],
        "agents_missing": 1 - batch["agent.seen"].float()[..., None].expand(-1, -1, -1, 5),
        "far": gc_pgp.far(batch),
        "poses": batch["map.pose"],
        "poses_missing": 1 - exists.float()[..., None].expand(-1, -1, -1, 7),
        "red": batch["map.red"].float()[..., None, None].expand(-1, -1, 20, 1),
        "successors": successors,
        "edges": edges,
        "on_route": torch.ones_like(edges),
        "walks": walks,
        "latent": latent,
    }
    out = {"policy": policy, "contexts": contexts, "trajectories": model.decoder(contexts, latent)}
    return {**named("in", given), **named("out", out)}


def scene(batch):
    names = {"ego": "ego_agent_past", "neighbors": "neighbor_agents_past", "lanes": "map_lanes"}
    names |= {"crosswalks": "map_crosswalks", "route": "route_lanes", "second": "tree"}
    return {theirs: batch[name] for name, theirs in names.items() if name in batch}


def gameformer_io(model, batch):
    levels, plan = model(batch)
    out = {"ego_plan": plan}
    for i, (futures, scores) in enumerate(levels):
        out |= {f"level_{i}_interactions": futures, f"level_{i}_scores": scores}
    return {**named("in", scene(batch)), **named("out", out)}


def dtpp_io(model, batch):
    # The original's masks of a batch are mixed; one sample is not affected.
    batch = {name: tensor[:1] for name, tensor in batch.items()}
    [(futures, scores, ego, weights)] = model(batch, stages=(("second", 80),))
    out = {"agent_trajectories": futures, "scores": scores, "ego_regularization": ego, "weights": weights}
    return {**named("in", scene(batch)), **named("out", out)}


SMALL_ACTORS = {"dim": 16, "layers": 2}
# Planner, a small model, its samples, its inputs and outputs, epochs.
CASES = {
    "pdm-open": (pdm_open, lambda: pdm_open.Model(hidden=32), pdm_open_samples, pdm_open_io, 12),
    "plantf": (plantf, lambda: plantf.Model(dim=32, depth=2, heads=4, modes=3), plantf_samples, plantf_io, 6),
    "urban-driver": (urban_driver, lambda: urban_driver.Model(width=32, layers=2), urban_driver_samples, urban_driver_io, 25),
    "raster-model": (raster_model, lambda: raster_model.Model((16, 8, 16, 32)), raster_model_samples, raster_model_io, 25),
    "gc-pgp": (gc_pgp, gc_pgp.Model, gc_pgp_samples, gc_pgp_io, 12),
    "gameformer": (
        gameformer,
        lambda: gameformer.Model(**SMALL_ACTORS, levels=2, modes=3, neighbors=4),
        gameformer_samples,
        gameformer_io,
        6,
    ),
    "dtpp": (dtpp, lambda: dtpp.Model(**SMALL_ACTORS, inner=4, neighbors=4), dtpp_samples, dtpp_io, 25),
}


def run(folder=None):
    """Fails where a loss falls neither by a fifth nor by 0.5, or an augmentation by nothing changes a sample."""
    for name, (planner, small, samples, io, epochs) in CASES.items():
        torch.manual_seed(0)
        samples = samples(Made())
        if name in ("gameformer", "dtpp"):
            samples.tensors["futures"] = samples.tensors["futures"][:, :4]
        rate, planner.optimizer = planner.optimizer, faster(planner.optimizer)
        options = argparse.Namespace(out=None, resume=False, seed=0, device="cpu", epochs=epochs, batch=16, rate=None, minutes=None)
        model, log = train(planner, samples, samples, options, small)
        planner.optimizer = rate
        assert log[-1]["loss"] < 0.8 * log[0]["loss"] or log[-1]["loss"] < log[0]["loss"] - 0.5, f"{name}: {log}"
        if name == "plantf":
            # A frame that is moved by nothing is the same frame.
            planner.PERTURBATION = (0.0,) * 7
            batch = samples.batch(torch.arange(8))
            for key, tensor in planner.augmented(batch, torch.Generator().manual_seed(0)).items():
                assert torch.allclose(tensor.float(), batch[key].float(), atol=1e-5), f"{name}: {key}"
        if folder:
            Path(folder).mkdir(parents=True, exist_ok=True)
            model.eval()
            with torch.no_grad():
                save(model, Path(folder) / f"{name}.safetensors")
                save_file(io(model, samples.batch(torch.arange(2))), Path(folder) / f"{name}.io.safetensors")
        print(f"{name}: loss {log[0]['loss']:.3f}, then {log[-1]['loss']:.3f}", file=sys.stderr)
    print("selftest passed", file=sys.stderr)


def faster(make):
    """An optimizer with larger steps, for few of them in small shapes."""

    def made(model):
        optimizer = make(model)
        for group in optimizer.param_groups:
            group["lr"] = max(group["lr"], min(30 * group["lr"], 5e-3))
        return optimizer

    return made
