"""Runs end as Python does, and nothing waits for ever, whatever planners call."""

import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import planagent
import pytest

SCENE = "generated/changing_lane/2"
SCENES = [f"generated/changing_lane/{seed}" for seed in range(4)]


def child(program, interrupt_after=None, timeout=60.0, signals=signal.SIGINT):
    """Runs a program; its first line says that it has begun. Gives exit code, output, errors and seconds."""
    process = subprocess.Popen(
        [sys.executable, "-u", "-W", "ignore", "-c", textwrap.dedent(program)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    started = time.monotonic()
    if interrupt_after is not None:
        assert process.stdout.readline() == "go\n"
        time.sleep(interrupt_after)
        started = time.monotonic()
        process.send_signal(signals)
    try:
        out, err = process.communicate(timeout=timeout)
    except subprocess.TimeoutExpired:
        process.kill()
        out, err = process.communicate()
        pytest.fail(f"it went on for {timeout} s: {out[-500:]} {err[-2000:]}")
    return process.returncode, out, err, time.monotonic() - started


BEGIN = """
import signal, sys, threading, time, planagent
signal.signal(signal.SIGINT, signal.default_int_handler)
scenes = [f"generated/changing_lane/{i}" for i in range(40)]
"""


@pytest.mark.parametrize(
    "step",
    [
        "time.sleep(0.01)",
        "time.sleep(3)",
        "[time.sleep(0.01) for _ in range(300)]",
        "threading.Event().wait()",
        "sum(i * i for i in range(3_000_000))",
        "planagent.Model().ask(o.image(), 'Which?', max_tokens=200)",
    ],
)
def test_ctrl_c_ends_the_process_as_python_does(step):
    program = f"{BEGIN}\ndef plan(o):\n    {step}\n    return o.code()\nprint('go', flush=True)\nplanagent.simulate(scenes, plan)"
    code, out, err, seconds = child(program, interrupt_after=0.7)
    assert code == -signal.SIGINT and err.strip().splitlines()[-1].startswith("KeyboardInterrupt"), (code, err[-2000:])
    assert seconds < 8


@pytest.mark.parametrize("exit", ["", "sys.exit(3)", "raise LookupError"])
def test_a_daemon_thread_at_exit(exit):
    program = f"""{BEGIN}
def plan(o):
    for _ in range(100): time.sleep(0.005)
    return o.code()
def tell(progress): time.sleep(0.001)
for planner in (plan, "pdm-closed", "plan-agent"):
    threading.Thread(target=planagent.simulate, args=(scenes, planner), kwargs=dict(progress=tell), daemon=True).start()
threading.Thread(target=lambda: planagent.Agent().plan(planagent.open(scenes[0]).observe()), daemon=True).start()
time.sleep(0.7)
{exit}
"""
    code, out, err, _ = child(program)
    assert code == {"": 0, "sys.exit(3)": 3, "raise LookupError": 1}[exit], (code, err[-2000:])
    assert "panick" not in err and "Fatal" not in err, err


def test_an_alarm_and_a_callback_end_a_run():
    program = f"""{BEGIN}
class Late(Exception): pass
def late(*_): raise Late
signal.signal(signal.SIGALRM, late)
def plan(o): time.sleep(0.2); return o.code()
def tell(progress): raise LookupError
for stop in ("alarm", "callback"):
    if stop == "alarm": signal.setitimer(signal.ITIMER_REAL, 0.5)
    try: planagent.simulate(scenes, plan, progress=tell if stop == "callback" else False)
    except (Late, LookupError) as error: print(type(error).__name__, error.results is None or len(error.results))
planagent.open(scenes[0]); print("opened")
"""
    code, out, err, _ = child(program)
    assert code == 0 and out.split()[0] == "Late" and out.split()[-1] == "opened" and "LookupError" in out, (code, out, err[-2000:])


def test_endless_recursion_in_a_planner_is_an_error_of_python():
    program = f"""{BEGIN}
def through_c(x): return sorted([1, 2], key=lambda y: through_c(y))
def plain(x): return plain(x)
def recursive(o): through_c(1)
def simple_one(o): plain(1)
print(planagent.simulate(scenes[0], [recursive, simple_one]).table()["error"])
"""
    code, out, err, _ = child(program)
    assert code == 0 and out.count("RecursionError") == 2, (code, out, err[-2000:])


def test_new_work_begins_at_once_after_an_interruption():
    program = f"""{BEGIN}
def stuck(o): threading.Event().wait()
print("go", flush=True)
try: planagent.simulate(scenes, stuck)
except KeyboardInterrupt: pass
begun = time.monotonic()
planagent.open(scenes[0]); planagent.Agent(planner="idm"); planagent.simulate(scenes[0], "simple")
print(time.monotonic() - begun)
"""
    code, out, err, _ = child(program, interrupt_after=1.0)
    assert code == 0 and float(out) < 8, (code, out, err[-2000:])


def test_ctrl_c_stops_runs_of_other_threads():
    program = f"""{BEGIN}
import asyncio
def slow(o): time.sleep(0.05); return o.code()
async def main():
    print("go", flush=True)
    await asyncio.get_running_loop().run_in_executor(None, lambda: planagent.simulate(scenes, slow))
asyncio.run(main())
"""
    code, out, err, seconds = child(program, interrupt_after=1.0)
    assert code == -signal.SIGINT and seconds < 6, (code, seconds, err[-2000:])


def test_the_handler_of_the_user_still_hears_signals_beside_a_run_of_a_thread():
    program = f"""{BEGIN}
heard = []
signal.signal(signal.SIGINT, lambda *_: heard.append(1))
def slow(o): time.sleep(0.05); return o.code()
caught = []
def work():
    try: planagent.simulate(scenes, slow)
    except KeyboardInterrupt: caught.append(1)
thread = threading.Thread(target=work); thread.start()
print("go", flush=True)
thread.join()
import os
os.kill(os.getpid(), signal.SIGINT); time.sleep(0.1)
print(len(heard), len(caught))
"""
    code, out, err, _ = child(program, interrupt_after=1.0)
    assert code == 0 and out == "2 1\n", (code, out, err[-2000:])


def test_a_command_ends_with_its_run(tmp_path):
    file = tmp_path / "pid"
    program = f"""{BEGIN}
print("go", flush=True)
planagent.simulate(scenes[0], "exec:echo $$ > {file}; exec sleep 60")
"""
    code, _, err, seconds = child(program, interrupt_after=2.0)
    assert code == -signal.SIGINT and seconds < 6, err[-2000:]
    with pytest.raises(ProcessLookupError):
        os.kill(int(file.read_text()), 0)


def test_a_run_is_stopped_from_another_thread(tmp_path):
    stop = threading.Event()

    def tell(progress):
        if progress.done:
            stop.set()

    out = tmp_path / "run"
    with pytest.raises(planagent.errors.RunStoppedError, match="resume") as caught:
        planagent.simulate([f"generated/changing_lane/{i}" for i in range(30)], "simple", out=out, stop=stop, progress=tell)
    so_far = caught.value.results
    assert 0 < len(so_far) < 30 and not so_far.is_complete and "not simulated" in repr(so_far)
    # It holds its folder no longer.
    assert planagent.open_run(out).table().to_dict() == so_far.table().to_dict()
    with pytest.raises(ValueError, match="stop is 3"):
        planagent.simulate(SCENE, "idm", stop=3)


def test_a_stopped_run_without_a_folder_gives_what_was_completed():
    stop = threading.Event()

    def tell(progress):
        if progress.done:
            stop.set()

    with pytest.raises(planagent.errors.RunStoppedError, match="were not kept") as caught:
        planagent.simulate([f"generated/changing_lane/{i}" for i in range(30)], "simple", stop=stop, progress=tell)
    so_far = caught.value.results
    assert 0 < len(so_far) < 30 and so_far.folder is None and "not simulated" in repr(so_far)


def test_a_stderr_that_is_closed_stops_no_run():
    program = f"{BEGIN}\nsys.stderr.close()\nr = planagent.simulate(scenes, 'simple', progress=True)\nprint(len(r) == len(scenes))"
    code, out, err, _ = child(program)
    assert code == 0 and out.strip().endswith("True"), (out, err)


class InThreads:
    """Asks for everything in threads of its own, and waits."""

    executor = ThreadPoolExecutor(8)
    agent = None

    def __deepcopy__(self, memo):
        return self

    def plan(self, observation):
        if observation.iteration % 30 == 0:
            calls = [
                lambda: self.agent.plan(observation),
                lambda: observation.score(observation.code().poses[None, 1:11]),
                lambda: planagent.open(SCENE).observe(),
                lambda: planagent.simulate(SCENE, "simple", limit=1),
            ]
            for future in [self.executor.submit(call) for call in calls]:
                future.result(timeout=60)
        return observation.code()


@pytest.mark.parametrize("threads", [1, 2])
def test_planners_wait_for_threads_of_their_own(threads):
    planner = InThreads()
    planner.agent = planagent.Agent()
    try:
        planagent.set_threads(threads)
        results = planagent.simulate(SCENES, planner)
    finally:
        planagent.set_threads(None)
    assert results.table()["error"] == [None] * len(SCENES)


def test_the_state_of_a_thread_lasts():
    local, loads = threading.local(), []

    def plan(observation):
        if not hasattr(local, "network"):
            local.network = object()
            loads.append(threading.current_thread())
        return observation.code()

    try:
        planagent.set_threads(1)
        for _ in range(3):
            planagent.simulate(SCENE, plan)
    finally:
        planagent.set_threads(None)
    assert len(loads) == 1 and type(loads[0]).__name__ != "_DummyThread"


def test_a_stress_of_the_pool_ends():
    script = Path(__file__).with_name("stress.py")
    done = subprocess.run([sys.executable, "-W", "ignore", script, "20"], capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stdout + done.stderr[-8000:]


@pytest.mark.parametrize(
    "error",
    ["ValueError('half \\udcff \\0 of a character')", "Untold()", "ValueError('x' * 10**6)", "Quit('\\udcff')", "StopIteration()"],
)
def test_whatever_a_planner_raises_fails_its_simulation_alone(error):
    exit, out, err, _ = child(
        f"""
        import planagent
        class Untold(Exception):
            def __str__(self):
                raise KeyboardInterrupt
        class Quit(BaseException):
            pass
        def own(observation):
            raise {error}
        results = planagent.simulate({SCENES!r}, {{"own": own, "idm": "idm"}})
        print(len(results.failures), len(results), all(failure.error and failure.traceback for failure in results.failures))
        """
    )
    assert (exit, out.split()[:2]) == (0, ["4", "8"]), err
