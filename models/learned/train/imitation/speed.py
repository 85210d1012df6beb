"""Times every network in its published shape with random parameters, one scene, two threads; writes checkpoints, inputs and outputs for
the bench of the program, which times itself on them."""

import json
import time
from pathlib import Path

import torch
from safetensors.torch import save_file

from . import dtpp, gameformer, gc_pgp, pdm_open, plantf, raster_model, selftest, urban_driver
from .selftest import Made
from .training import save

THREADS, SECONDS, LEAST = 2, 2.0, 5


def urban_driver_io(model, batch):
    selftest.ELEMENTS = (1, 30, 30, 30, 30, 20, 20, 30)
    io = selftest.urban_driver_io(model, batch)
    given = {name: tensor[:1].contiguous() for name, tensor in io.items()}
    kinds = torch.cat([torch.full((n,), kind) for n, kind in zip(selftest.ELEMENTS, (0, 1, *urban_driver.LAYERS))])
    points, available = given["in.points"], given["in.available"].bool()
    run = lambda: model.plan(points, available, kinds[None])
    return given, run


def raster_model_io(model, batch):
    batch = {"raster": (Made().normal(1, 4, 224, 224) > 1).float()}
    given = selftest.named("in", batch) | selftest.named("out", {"trajectory": model(batch)})
    return given, lambda: model(batch)


def gc_pgp_io(model, batch):
    io = selftest.gc_pgp_io(model, batch, samples=1000)
    walks, latent = io["in.walks"].long(), io["in.latent"]

    def run():
        ego, nodes = model.encoder(batch)
        model.aggregator.policy(ego, nodes, batch)
        # The program attends once to walks that are equal; so does the original.
        unique, place = torch.unique(walks[0], dim=0, return_inverse=True)
        model.decoder(model.aggregator.contexts(ego, nodes, unique[None])[:, place], latent)

    return io, run


def whole(io):
    """A network whose exported outputs are those of the whole."""

    def made(model, batch):
        stages = {"stages": (("second", 80),)} if io is selftest.dtpp_io else {}
        return io(model, batch), lambda: model(batch, **stages)

    return made


CASES = {
    "pdm-open": (pdm_open, selftest.pdm_open_samples, whole(selftest.pdm_open_io)),
    "plantf": (plantf, lambda made: selftest.plantf_samples(made, 2, agents=33, polygons=120), whole(selftest.plantf_io)),
    "urban-driver": (urban_driver, selftest.urban_driver_samples, urban_driver_io),
    "raster-model": (raster_model, selftest.raster_model_samples, raster_model_io),
    "gc-pgp": (gc_pgp, lambda made: selftest.gc_pgp_samples(made, 2, agents=20, nodes=120), gc_pgp_io),
    "gameformer": (gameformer, lambda made: selftest.gameformer_samples(made, 2), whole(selftest.gameformer_io)),
    "dtpp": (dtpp, lambda made: selftest.dtpp_samples(made, 2), whole(selftest.dtpp_io)),
}


def timed(run):
    """Median of runs, milliseconds."""
    run()
    times, begun = [], time.perf_counter()
    while len(times) < LEAST or time.perf_counter() - begun < SECONDS:
        started = time.perf_counter()
        run()
        times.append(1e3 * (time.perf_counter() - started))
    return sorted(times)[len(times) // 2]


def run(folder):
    torch.set_num_threads(THREADS)
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    found = {}
    for name, (planner, samples, io) in CASES.items():
        torch.manual_seed(0)
        model = planner.Model().eval()
        batch = samples(Made()).batch(torch.arange(1))
        with torch.no_grad():
            given, forward = io(model, batch)
            save(model, folder / f"{name}.safetensors")
            save_file(given, folder / f"{name}.io.safetensors")
            parameters = sum(parameter.numel() for parameter in model.parameters())
            found[name] = {"parameters": parameters, "ms": timed(forward)}
    print(json.dumps({"torch": torch.__version__, "threads": THREADS, "planners": found}))
