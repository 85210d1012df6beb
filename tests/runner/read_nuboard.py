"""Opens the `.nuboard` files of a run as nuBoard does, and checks what they name.

Usage: read_nuboard.py RUN

With PLANAGENT_DEVKIT (the folder of nuplan-devkit's sources), the devkit's own classes open them too.
"""

import importlib.util
import json
import os
import pickle
import sys
from pathlib import Path

FOLDERS = ["metric_folder", "aggregator_metric_folder"]


def open_plainly(folder):
    """The dictionary of the devkit's NuBoardFile, without the devkit."""
    (file,) = folder.glob("*.nuboard")
    with open(file, "rb") as stream:
        found = pickle.load(stream)
    assert type(found) is dict and found == {
        "simulation_main_path": folder.name,
        "metric_main_path": f"../{folder.name}",
        "metric_folder": "metrics",
        "aggregator_metric_folder": "aggregator_metric",
        "simulation_folder": "simulation_log",
    }, found
    for name in FOLDERS:
        assert any((folder / found[name]).iterdir()), f"{folder / found[name]} is empty"
    # A file that is loaded in the browser: nuBoard works in a folder of the run then, and names the last two parts.
    loaded = Path(found["metric_main_path"])
    assert len(loaded.parts) >= 2 and (folder / loaded).resolve() == folder.resolve()
    return file


def open_with_devkit(folders, summary):
    """The files by the devkit's own class; with bokeh, also what nuBoard's overview and histograms show."""
    from nuplan.planning.nuboard.utils.utils import check_nuboard_file_paths, read_nuboard_file_paths

    files = read_nuboard_file_paths(check_nuboard_file_paths([str(folder) for folder in folders]))
    for folder, file in zip(folders, files):
        assert file.current_path == folder and file.metric_folder == "metrics", file
    print("opened by the devkit")
    if importlib.util.find_spec("bokeh") is None:
        print("SKIPPED: tables and histograms, because this Python has no bokeh", file=sys.stderr)
        return
    from nuplan.planning.nuboard.base.experiment_file_data import ExperimentFileData

    data = ExperimentFileData(file_paths=files)
    for index, folder in enumerate(folders):
        scores = {row["planner"]: row["score"] for row in summary["aggregates"] if row["challenge"] == folder.name}
        assert set(data.file_path_colors[index]) == set(scores), data.file_path_colors
        metrics = {frame.metric_statistic_name for frame in data.metric_statistics_dataframes[index]}
        assert metrics == {path.stem for path in (folder / "metrics").iterdir()} and len(metrics) >= 8, metrics
        ((name, frame),) = data.metric_aggregator_dataframes[index].items()
        assert name.startswith(f"{folder.name}_weighted_average_metrics_"), name
        final = frame[frame["scenario"] == "final_score"]
        assert dict(zip(final["planner_name"], final["score"])) == scores


def main():
    run = Path(sys.argv[1])
    summary = json.loads((run / "summary.json").read_text())
    folders = [run / challenge for challenge in sorted({row["challenge"] for row in summary["scenarios"]})]
    for folder in folders:
        assert str(run).encode() not in open_plainly(folder).read_bytes(), "the file names this machine's folder"
    print(f"{len(folders)} files opened")
    devkit = os.environ.get("PLANAGENT_DEVKIT")
    if devkit:
        sys.path.insert(0, devkit)
        open_with_devkit(folders, summary)


main()
