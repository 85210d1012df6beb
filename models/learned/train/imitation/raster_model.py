"""RasterModel with the parameter names of nuplan-devkit and timm's resnet50."""

import torch
from torch import nn
from torch.nn import functional as F

from . import blocks

POSES = 16
# The shape of `raster-model-small`.
SMALL = {"widths": (16, 32, 64, 128)}


class Bottleneck(nn.Module):
    def __init__(self, inputs, width, stride):
        super().__init__()
        self.conv1, self.bn1 = nn.Conv2d(inputs, width, 1, bias=False), nn.BatchNorm2d(width)
        self.conv2, self.bn2 = nn.Conv2d(width, width, 3, stride, 1, bias=False), nn.BatchNorm2d(width)
        self.conv3, self.bn3 = nn.Conv2d(width, 4 * width, 1, bias=False), nn.BatchNorm2d(4 * width)
        self.downsample = None
        if stride != 1 or inputs != 4 * width:
            shortcut = nn.Conv2d(inputs, 4 * width, 1, stride, bias=False)
            self.downsample = nn.Sequential(shortcut, nn.BatchNorm2d(4 * width))

    def forward(self, x):
        y = F.relu(self.bn1(self.conv1(x)))
        y = self.bn3(self.conv3(F.relu(self.bn2(self.conv2(y)))))
        return F.relu(y + (x if self.downsample is None else self.downsample(x)))


class ResNet(nn.Module):
    def __init__(self, widths):
        super().__init__()
        self.conv1, self.bn1 = nn.Conv2d(4, 64, 7, 2, 3, bias=False), nn.BatchNorm2d(64)
        inputs = 64
        for stage, (width, blocks_) in enumerate(zip(widths, (3, 4, 6, 3))):
            made = []
            for block in range(blocks_):
                made.append(Bottleneck(inputs, width, 2 if block == 0 and stage > 0 else 1))
                inputs = 4 * width
            setattr(self, f"layer{stage + 1}", nn.Sequential(*made))
        self.fc = nn.Linear(inputs, 3 * POSES)

    def forward(self, x):
        x = F.max_pool2d(F.relu(self.bn1(self.conv1(x))), 3, 2, 1)
        for layer in (self.layer1, self.layer2, self.layer3, self.layer4):
            x = layer(x)
        return self.fc(x.mean((2, 3)))


class Model(nn.Module):
    def __init__(self, widths=(64, 128, 256, 512)):
        super().__init__()
        self._model = ResNet(widths)

    def forward(self, batch):
        raster = batch["raster"]
        # A dataset holds twice the values in bytes.
        raster = raster.float() / 2 if raster.dtype == torch.uint8 else raster
        return self._model(raster).view(-1, POSES, 3)


def loss(model, batch):
    return (model(batch) - batch["target"]).abs().mean()


def augmented(batch, generator):
    return batch


def displacement(model, batch):
    return blocks.displacements(model(batch), batch)


def optimizer(model):
    return torch.optim.Adam(model.parameters(), lr=1e-4, weight_decay=5e-4)


learning_rate = blocks.steps(0.5, 0.75)
EPOCHS, BATCH, GRADIENT_NORM = 100, 64, None
