"""Trains a learned planner: python -m imitation PLANNER --data FOLDER --out FILE.safetensors; or: python -m imitation selftest."""

import argparse
import json
import sys
import time

import torch
from safetensors.torch import save_file

from . import pdm_open, plantf, shards, vectors

PLANNERS = {"pdm-open": (pdm_open, shards.Flat), "plantf": (plantf, shards.Ragged)}


def moved(batch, device):
    return {name: tensor.to(device) for name, tensor in batch.items()}


def evaluate(planner, model, samples, batch, device):
    model.eval()
    sums, count = torch.zeros(2), 0
    with torch.no_grad():
        for places in torch.arange(samples.count).split(batch):
            found = planner.displacement(model, moved(samples.batch(places), device))
            sums += torch.stack([values.sum().cpu() for values in found])
            count += len(places)
    model.train()
    return (sums / count).tolist()


def train(planner, training, validation, options):
    torch.manual_seed(options.seed)
    generator = torch.Generator().manual_seed(options.seed)
    model = planner.Model().to(options.device)
    optimizer = planner.optimizer(model)
    rates = [group["lr"] for group in optimizer.param_groups]
    started, log = time.monotonic(), []
    for epoch in range(options.epochs):
        factor = planner.learning_rate(epoch, options.epochs)
        for group, rate in zip(optimizer.param_groups, rates):
            group["lr"] = rate * factor
        total, steps = 0.0, 0
        for places in torch.randperm(training.count, generator=generator).split(options.batch):
            if len(places) < 2:
                continue
            batch = planner.augmented(moved(training.batch(places), options.device), generator)
            loss = planner.loss(model, batch)
            optimizer.zero_grad()
            loss.backward()
            if planner.GRADIENT_NORM:
                torch.nn.utils.clip_grad_norm_(model.parameters(), planner.GRADIENT_NORM)
            optimizer.step()
            total, steps = total + loss.item(), steps + 1
        own, straight = evaluate(planner, model, validation, options.batch, options.device)
        minutes = (time.monotonic() - started) / 60
        log.append({"epoch": epoch + 1, "loss": total / max(steps, 1), "displacement_m": own, "minutes": minutes})
        print(
            f"epoch {epoch + 1} of {options.epochs}: loss {total / max(steps, 1):.4f}, displacement {own:.3f} m "
            f"(constant velocity {straight:.3f} m), {minutes:.1f} minutes",
            file=sys.stderr,
        )
        if options.minutes and minutes >= options.minutes:
            break
    return model, log


def random_samples(planner, count=256):
    """Samples whose target follows from their state, in the layout of a dataset."""
    generator = torch.Generator().manual_seed(1)
    normal = lambda *shape: torch.randn(*shape, generator=generator)
    speed = 10 * torch.rand(count, 1, generator=generator)
    if planner is pdm_open:
        times = 0.5 * torch.arange(1, 17)
        velocity = normal(count, 11, 3) * 0.1
        velocity[:, :, 0] = speed
        target = torch.stack([speed * times, 0 * times * speed, 0 * times * speed], -1)
        made = {"position": normal(count, 11, 3), "velocity": velocity, "acceleration": normal(count, 11, 3)}
        return shards.Flat({**made, "centerline": normal(count, 120, 3), "target": target})
    times, agents, polygons = 0.1 * torch.arange(1, 81), 3, 4
    state = torch.cat([torch.zeros(count, 3), speed, normal(count, 3) * 0.1], 1)
    target = torch.stack([speed * times, 0 * times * speed, 0 * times * speed], -1)
    rows, areas = count * agents, count * polygons
    flags = lambda *shape: torch.ones(shape, dtype=torch.uint8)
    return shards.Ragged(
        {
            "target": target,
            "current_state": state,
            "agents": torch.full((count,), agents, dtype=torch.uint8),
            "polygons": torch.full((count,), float(polygons)),
            "agent.position": normal(rows, 21, 2) * 30,
            "agent.heading": normal(rows, 21),
            "agent.velocity": normal(rows, 21, 2),
            "agent.shape": flags(rows, 21, 2).float() * 2,
            "agent.valid": flags(rows, 21),
            "agent.category": flags(rows),
            "agent.target": normal(rows, 80, 3),
            "agent.target_valid": flags(rows, 80),
            "map.point": normal(areas, 20, 2) * 30,
            "map.vector": normal(areas, 20, 2),
            "map.orientation": normal(areas, 20),
            "map.speed_limit": flags(areas).float() * 10,
            "map.has_speed_limit": flags(areas),
            "map.kind": flags(areas),
            "map.on_route": flags(areas),
            "map.light": flags(areas) * 3,
            "map.valid": flags(areas, 20),
        }
    )


def selftest():
    for name, (planner, _) in PLANNERS.items():
        samples = random_samples(planner)
        options = argparse.Namespace(seed=0, device="cpu", epochs=6, batch=32, minutes=None)
        model, log = train(planner, samples, samples, options)
        assert log[-1]["loss"] < 0.8 * log[0]["loss"], f"{name}: {log}"
        # A frame that is moved by nothing is the same frame.
        planner.PERTURBATION = (0.0,) * 7
        batch = samples.batch(torch.arange(8))
        for key, tensor in planner.augmented(batch, torch.Generator().manual_seed(0)).items():
            assert torch.allclose(tensor.float(), batch[key].float(), atol=1e-5), f"{name}: {key}"
    print("selftest passed", file=sys.stderr)


def main():
    parser = argparse.ArgumentParser(prog="python -m imitation", description=__doc__)
    parser.add_argument("planner", choices=[*PLANNERS, "selftest", "vectors"])
    parser.add_argument("--data", help="folder of `planagent dataset --for imitation`")
    parser.add_argument("--out", help="checkpoint to write, FILE.safetensors")
    parser.add_argument("--epochs", type=int, help="default: those of the authors")
    parser.add_argument("--batch", type=int, help="default: that of the authors")
    parser.add_argument("--minutes", type=float, help="end after the epoch in which so many minutes have passed")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--half", action="store_true", help="write f16")
    options = parser.parse_args()
    if options.planner == "selftest":
        return selftest()
    if options.planner == "vectors":
        return vectors.check(options.data)
    if not (options.data and options.out):
        parser.error("--data and --out are needed")
    planner, samples = PLANNERS[options.planner]
    options.epochs, options.batch = options.epochs or planner.EPOCHS, options.batch or planner.BATCH
    training, validation = (samples(shards.load(options.data, split)) for split in ("train", "validation"))
    model, log = train(planner, training, validation, options)
    tensors = {name: tensor.cpu().contiguous() for name, tensor in model.state_dict().items()}
    if options.half:
        tensors = {name: tensor.half() if tensor.is_floating_point() else tensor for name, tensor in tensors.items()}
    save_file(tensors, options.out)
    print(json.dumps({"planner": options.planner, "samples": training.count, **log[-1]}))


main()
