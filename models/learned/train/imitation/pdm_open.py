"""PDM-Open with the parameter names of tuplan_garage."""

import torch
from torch import nn

POSES = 16


class Model(nn.Module):
    def __init__(self, hidden=512):
        super().__init__()
        self.state_encoding = nn.Sequential(nn.Linear(99, hidden), nn.ReLU())
        self.centerline_encoding = nn.Sequential(nn.Linear(360, hidden), nn.ReLU())
        self.planner_head = nn.Sequential(
            nn.Linear(2 * hidden, hidden),
            nn.Dropout(0.1),
            nn.ReLU(),
            nn.Linear(hidden, hidden),
            nn.ReLU(),
            nn.Linear(hidden, 3 * POSES),
        )

    def forward(self, batch):
        flat = [batch[name].flatten(1) for name in ("position", "velocity", "acceleration")]
        encodings = [self.state_encoding(torch.cat(flat, 1)), self.centerline_encoding(batch["centerline"].flatten(1))]
        return self.planner_head(torch.cat(encodings, 1)).view(-1, POSES, 3)


def loss(model, batch):
    return (model(batch) - batch["target"]).abs().mean()


def augmented(batch, generator):
    return batch


def displacement(model, batch):
    """Mean distance between plan and driver over the poses, of the model and of constant velocity, meters."""
    plan, target = model(batch)[..., :2], batch["target"][..., :2]
    times = 0.5 * torch.arange(1, POSES + 1, device=plan.device)
    speed = batch["velocity"][:, -1, :1]
    straight = torch.stack([speed * times, torch.zeros_like(speed) * times], -1)
    return (plan - target).norm(dim=-1).mean(1), (straight - target).norm(dim=-1).mean(1)


def optimizer(model):
    return torch.optim.Adam(model.parameters(), lr=1e-4, weight_decay=5e-4)


def learning_rate(epoch, epochs):
    """Factor of an epoch from 0 on."""
    return 0.1 ** ((epoch >= epochs * 0.5) + (epoch >= epochs * 0.75))


EPOCHS, BATCH, GRADIENT_NORM = 100, 64, None
