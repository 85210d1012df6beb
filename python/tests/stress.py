"""A stress of the pool: `python stress.py [SECONDS] [SEED]`.

Threads and planners call all that computes, in an order that a seed draws: agents and models that all share, simulations in simulations,
scores, scenes, environments, another number of threads, runs that are stopped. It ends by itself; where nothing has ended for a while, the
stacks of all threads are printed and the exit code is 1.
"""

import concurrent.futures
import faulthandler
import json
import os
import random
import sys
import threading
import time

import numpy as np
import planagent

SCENES = [f"generated/{kind}/{seed}" for kind in ("changing_lane", "stopping_with_lead") for seed in (1, 2, 3)]
#: Longest time without the end of any call, seconds; the machine may be busy.
STILL_S = 25.0


class Stress:
    def __init__(self, seconds: float, seed: int) -> None:
        self.until, self.seed = time.monotonic() + seconds, seed
        self.agents = [planagent.Agent(), planagent.Agent(planner="pdm-closed")]
        self.model = planagent.Model()
        self.scenarios = [planagent.open(scene) for scene in SCENES]
        self.executor = concurrent.futures.ThreadPoolExecutor(4)
        self.counts: dict[str, int] = {}
        self.lock = threading.Lock()
        self.last = time.monotonic()

    def ended(self, name: str) -> None:
        with self.lock:
            self.counts[name] = self.counts.get(name, 0) + 1
            self.last = time.monotonic()

    def is_over(self) -> bool:
        return time.monotonic() > self.until

    def call(self, drawn: random.Random, observation: planagent.Observation, depth: int) -> None:
        """One call of those that a user makes anywhere."""
        names = ["agent", "agent", "ask", "score", "open", "threads", "step", "run", "simulate", "stop", "pool"]
        name = drawn.choice(names[: 7 if depth > 1 else len(names)])
        if name == "agent":
            drawn.choice(self.agents).plan(observation)
        elif name == "ask":
            self.model.ask(observation.image(), "Which?", choices=["a", "b"])
        elif name == "score":
            observation.score(np.tile(observation.ego.pose, (3, 10, 1)))
        elif name == "open":
            planagent.open(f"generated/changing_lane/{drawn.randrange(1000)}").observe()
        elif name == "threads":
            planagent.set_threads(drawn.choice([1, 2, 3, None]))
        elif name == "step":
            simulation = planagent.Simulation(drawn.choice(self.scenarios))
            simulation.run("idm", steps=3)
        elif name == "run":
            planagent.Simulation(drawn.choice(self.scenarios), "reactive").run(lambda o: o.code(), steps=3)
        elif name == "pool":
            # A planner waits for another thread, which waits for the pool.
            self.executor.submit(drawn.choice(self.agents).plan, observation).result()
        else:
            stop = threading.Event()
            if name == "stop":
                threading.Timer(drawn.random() * 0.5, stop.set).start()
            try:
                planner = self.planner(drawn.randrange(1 << 30), depth + 1)
                results = planagent.simulate(drawn.sample(SCENES, 2), [planner, "simple"], stop=stop)
                assert results.table()["error"] == [None] * 4, results.failures
            except planagent.errors.RunStoppedError:
                assert name == "stop"
        self.ended(name)

    def planner(self, seed: int, depth: int):
        """A planner that calls the package now and then."""

        def plan(observation):
            drawn = random.Random(f"{seed} {observation.iteration}")
            if observation.iteration % 40 == 0 and not self.is_over():
                self.call(drawn, observation, depth)
            return observation.code()

        return plan

    def thread(self, number: int) -> None:
        drawn = random.Random(f"{self.seed} {number}")
        while not self.is_over():
            self.call(drawn, drawn.choice(self.scenarios).observe(drawn.randrange(100)), 0)


def main() -> int:
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 20.0
    stress = Stress(seconds, int(sys.argv[2]) if len(sys.argv) > 2 else 1)
    # Those that are left at an error shall not hold the process.
    failed = []

    def run(number):
        try:
            stress.thread(number)
        except BaseException as error:
            failed.append(repr(error))
            raise

    threads = [threading.Thread(target=run, args=(number,), daemon=True) for number in range(6)]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads):
        time.sleep(0.1)
        if time.monotonic() - stress.last > STILL_S:
            faulthandler.dump_traceback(all_threads=True)
            print(f"nothing has ended for {STILL_S} s; before: {stress.counts}", file=sys.stderr, flush=True)
            os._exit(1)
    print(json.dumps(stress.counts), flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
