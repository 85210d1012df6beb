"""The loop over epochs, the same for all planners."""

import os
import sys
import time

import torch
from safetensors.torch import save_file


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


def train(planner, training, validation, options, make):
    torch.manual_seed(options.seed)
    generator = torch.Generator().manual_seed(options.seed)
    model = make().to(options.device)
    optimizer = planner.optimizer(model)
    rates = [options.rate or group["lr"] for group in optimizer.param_groups]
    log = resume(options.out, model, optimizer, generator) if options.resume else []
    started = time.monotonic() - 60 * (log[-1]["minutes"] if log else 0)
    for epoch in range(len(log), options.epochs):
        if hasattr(planner, "begin_epoch"):
            planner.begin_epoch(model, epoch, options.epochs)
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
                for part in planner.clipped(model) if hasattr(planner, "clipped") else [model]:
                    torch.nn.utils.clip_grad_norm_(part.parameters(), planner.GRADIENT_NORM)
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
        keep(options.out, model, optimizer, generator, log)
        if options.minutes and minutes >= options.minutes:
            break
    return model, log


def progress_file(path):
    return f"{path}.progress"


def keep(path, model, optimizer, generator, log):
    """Writes what `--resume` goes on from: whole or not at all."""
    if not path:
        return
    state = {
        "model": model.state_dict(),
        "optimizer": optimizer.state_dict(),
        "random": torch.get_rng_state(),
        "order": generator.get_state(),
        "log": log,
    }
    torch.save(state, f"{progress_file(path)}.new")
    os.replace(f"{progress_file(path)}.new", progress_file(path))


def resume(path, model, optimizer, generator):
    """The epochs done before, with the model, the optimizer and the random numbers as they were after them."""
    if not os.path.exists(progress_file(path)):
        return []
    state = torch.load(progress_file(path), weights_only=True)
    model.load_state_dict(state["model"])
    optimizer.load_state_dict(state["optimizer"])
    torch.set_rng_state(state["random"])
    generator.set_state(state["order"])
    return state["log"]


def save(model, path, half=False):
    """Writes the parameters and buffers; modules that are used twice are written twice."""
    tensors = {name: tensor.detach().cpu().contiguous().clone() for name, tensor in model.state_dict().items()}
    if half:
        tensors = {name: tensor.half() if tensor.is_floating_point() else tensor for name, tensor in tensors.items()}
    save_file(tensors, path)
