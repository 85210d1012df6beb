"""Modules that the networks share, and changes of samples."""

import torch
from torch import nn
from torch.nn import functional as F


def split_linear(linear, own, shared):
    """The two summands of `linear(cat(own, shared))`. Many own rows have the same shared row, so shared rows are multiplied once."""
    weight, beside = linear.weight.split([own.shape[-1], shared.shape[-1]], 1)
    return F.linear(own, weight), F.linear(shared, beside, linear.bias)


def straight(speed, times):
    """Places of constant velocity (B, T, 2)."""
    times = times.to(speed.device)
    return torch.stack([speed[:, None] * times, torch.zeros_like(speed)[:, None] * times], -1)


def displacements(plan, batch, step=0.5):
    """Mean distance between plan and driver over the poses, of the model and of constant velocity, meters."""
    target = batch["target"][..., :2]
    times = step * torch.arange(1, target.shape[1] + 1)
    return (plan[..., :2] - target).norm(dim=-1).mean(1), (straight(batch["speed"], times) - target).norm(dim=-1).mean(1)


def nuplan_loss(plan, target):
    """Mean squared error of the places plus mean absolute error of the headings (nuplan-devkit's imitation objective)."""
    return F.mse_loss(plan[..., :2], target[..., :2]) + F.l1_loss(plan[..., 2], target[..., 2])


def steps(*milestones, factor=0.1):
    """A schedule that multiplies the learning rate by a factor at each milestone, a share of the epochs."""
    return lambda epoch, epochs: factor ** sum(epoch >= epochs * milestone for milestone in milestones)


def without_agents(batch, generator, key, chance=0.5, rate=0.5):
    """Half of the samples lose each agent with a probability; `key` is the mask of agents (B, N)."""
    mask = batch[key]
    sample = torch.rand(len(mask), 1, generator=generator).to(mask.device) < chance
    dropped = torch.rand(mask.shape, generator=generator).to(mask.device) < rate
    return {**batch, key: mask & ~(sample & dropped)}


def bent_history(history, noise, chosen):
    """Histories (B, T, 2 or 3), oldest first, led smoothly to a present pose that is moved by noise (B, 2 or 3)."""
    t = torch.linspace(0, 1, history.shape[1], device=history.device)
    ease = t**3 * (10 - 15 * t + 6 * t**2)
    return history + ease[None, :, None] * noise[:, None] * chosen[:, None, None]


def feasible(history, step, limits=(0.2, 4.0, 1.75)):
    """Whether curvature (1 per meter), acceleration (m/s^2) and yaw rate (1 per second) of histories (B, T, 3) stay in bounds, forward."""
    curvature, acceleration, rate = limits
    moved = history[:, 1:, :2] - history[:, :-1, :2]
    heading = history[:, :-1, 2]
    forward = moved[..., 0] * heading.cos() + moved[..., 1] * heading.sin()
    speed = moved.norm(dim=-1) / step
    turn = (history[:, 1:, 2] - history[:, :-1, 2]).abs() / step
    change = (speed[:, 1:] - speed[:, :-1]).abs() / step
    fine = (turn <= rate) & (turn <= curvature * speed + 1e-3) & (forward >= -1e-3)
    return fine.all(1) & (change <= acceleration).all(1)
