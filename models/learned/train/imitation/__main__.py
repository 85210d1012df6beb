"""Trains a learned planner: python -m imitation PLANNER --data FOLDER --out FILE.safetensors; or: python -m imitation selftest."""

import argparse
import json

from . import dtpp, gameformer, gc_pgp, pdm_open, plantf, raster_model, selftest, shards, speed, urban_driver, vectors
from .training import save, train

# Planner, its samples, its shape where it is not the published one.
PLANNERS = {
    "pdm-open": (pdm_open, shards.Flat, {}),
    "plantf": (plantf, shards.Ragged, {}),
    "urban-driver": (urban_driver, shards.Ragged, {}),
    "raster-model": (raster_model, shards.Flat, {}),
    "raster-model-small": (raster_model, shards.Flat, raster_model.SMALL),
    "gc-pgp": (gc_pgp, shards.Ragged, {}),
    "gameformer": (gameformer, shards.Flat, {}),
    "gameformer-small": (gameformer, shards.Flat, gameformer.SMALL),
    "dtpp": (dtpp, shards.Flat, {}),
    "dtpp-small": (dtpp, shards.Flat, dtpp.SMALL),
}


def main():
    parser = argparse.ArgumentParser(prog="python -m imitation", description=__doc__)
    parser.add_argument("planner", choices=[*PLANNERS, "selftest", "speed", "vectors"])
    parser.add_argument("--data", help="folder of `planagent dataset --for imitation`")
    parser.add_argument("--out", help="checkpoint to write, FILE.safetensors; with selftest, a folder for small checkpoints")
    parser.add_argument("--epochs", type=int, help="default: those of the authors")
    parser.add_argument("--batch", type=int, help="default: that of the authors")
    parser.add_argument("--rate", type=float, help="learning rate before its schedule; default: that of the authors")
    parser.add_argument("--minutes", type=float, help="end after the epoch in which so many minutes have passed")
    parser.add_argument("--resume", action="store_true", help="go on after the last whole epoch of an interrupted training")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--half", action="store_true", help="write f16")
    options = parser.parse_args()
    if options.planner == "selftest":
        return selftest.run(options.out)
    if options.planner == "speed":
        return speed.run(options.out)
    if options.planner == "vectors":
        return vectors.check(options.data)
    if not (options.data and options.out):
        parser.error("--data and --out are needed")
    planner, samples, shape = PLANNERS[options.planner]
    options.epochs, options.batch = options.epochs or planner.EPOCHS, options.batch or planner.BATCH
    training, validation = (samples(shards.load(options.data, split)) for split in ("train", "validation"))
    model, log = train(planner, training, validation, options, lambda: planner.Model(**shape))
    save(model, options.out, options.half)
    print(json.dumps({"planner": options.planner, "samples": training.count, **log[-1]}))


main()
