"""Threads, signals, forks and panics."""

import multiprocessing
import os
import signal
import subprocess
import sys
import textwrap
import threading
import time

import planagent
import pytest

SCENE = "generated/changing_lane/2"
SCENES = [f"generated/{kind}/{seed}" for kind in ("changing_lane", "stopping_with_lead") for seed in range(30)]


def score(challenge="nonreactive"):
    return planagent.simulate(SCENE, "plan-agent", challenge=challenge).table().to_dict()["score"][0]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="fork")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_fork_has_threads_of_its_own():
    expected = score()
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        signal.alarm(60)
        os.write(writer, repr(score()).encode())
        os._exit(0)
    os.close(writer)
    with os.fdopen(reader) as pipe:
        assert float(pipe.read()) == expected
    assert os.waitpid(child, 0)[1] == 0


def test_a_spawned_process_gives_the_same():
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        assert pool.map(score, ["reactive"]) == [score("reactive")]


def test_ctrl_c_stops_a_run_which_is_resumed(tmp_path):
    program = textwrap.dedent(
        f"""
        import signal, sys, planagent
        # A shell starts background jobs with the signal ignored.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        scenes = {SCENES!r}
        def tell(progress):
            if progress.done > 2:
                print("go", flush=True)
        try:
            planagent.simulate(scenes, "pdm-closed", out={str(tmp_path / 'run')!r}, progress=tell)
        except KeyboardInterrupt:
            print("stopped", flush=True)
            sys.exit(7)
        """
    )
    process = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "go\n"
    started = time.monotonic()
    process.send_signal(signal.SIGINT)
    while (line := process.stdout.readline()) != "stopped\n":
        assert line == "go\n", "the run went on to its end"
    seconds = time.monotonic() - started
    process.stdout.close()
    assert process.wait(30) == 7
    # On a machine that does nothing else it takes a tenth of that.
    assert seconds < 1.0
    kept = list((tmp_path / "run" / "simulations").iterdir())
    assert 2 < len(kept) < len(SCENES)
    resumed = planagent.resume(tmp_path / "run").table().to_dict()
    undisturbed = planagent.simulate(SCENES, "pdm-closed").table().to_dict()
    assert resumed["score"] == undisturbed["score"] and resumed["error"] == [None] * len(SCENES)


def test_other_threads_run_meanwhile():
    ticks = []
    done = threading.Event()

    def tick():
        while not done.is_set():
            ticks.append(time.monotonic())
            time.sleep(0.001)

    thread = threading.Thread(target=tick)
    thread.start()
    planagent.simulate([f"generated/changing_lane/{i}" for i in range(4)], "pdm-closed")
    done.set()
    thread.join()
    assert len(ticks) > 20


def test_simulations_run_in_several_threads():
    results = {}

    def work(challenge):
        results[challenge] = planagent.Simulation(SCENE, challenge).run("idm").score().value

    threads = [threading.Thread(target=work, args=(challenge,)) for challenge in ("nonreactive", "reactive")]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert set(results) == {"nonreactive", "reactive"}


def test_the_number_of_threads_can_be_set():
    try:
        planagent.set_threads(3)
        assert planagent.threads() == 3
        one = score()
        planagent.set_threads(1)
        assert planagent.threads() == 1 and score() == one
    finally:
        planagent.set_threads(None)
    assert planagent.threads() <= os.cpu_count()
    with pytest.raises(ValueError, match="1 to 512"):
        planagent.set_threads(0)


def test_the_environment_sets_the_number_of_threads():
    environment = {**os.environ, "PLANAGENT_THREADS": "5"}
    program = "import planagent; print(planagent.threads())"
    shown = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True)
    assert shown.stdout == "5\n"


@pytest.mark.parametrize("wrong", ["abc", "0", "1000", "2.5", "-1"])
def test_a_wrong_number_of_threads_in_the_environment_is_an_error(wrong):
    environment = {**os.environ, "PLANAGENT_THREADS": wrong}
    program = "import planagent; planagent.open('generated/changing_lane/2')"
    shown = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True)
    last = shown.stderr.strip().splitlines()[-1]
    assert shown.returncode == 1 and "ArgumentError" in last, shown.stderr
    assert f'PLANAGENT_THREADS is "{wrong}"; the number of threads must lie in 1 to 512' in last


def test_the_import_takes_numpy_alone():
    program = "import sys, planagent; print([m for m in ('gymnasium', 'nuplan', 'pandas', 'pyarrow') if m in sys.modules])"
    shown = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert shown.stdout == "[]\n"
