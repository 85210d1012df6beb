//! The commands of README.md and docs run as they stand there, in an empty folder, in their order.
//!
//! A command that cannot run here stands in [`NOT_RUN`] with its reason. The program must still
//! know all of its subcommands, options and values.

use super::text::{DocumentedCommand, commands};
use super::{docs, name, read, root};
use crate::outside::{Missing, Needy, program, python};
use crate::womd::written;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use tempfile::TempDir;

const CARGO: &str = "builds this program";
const HOURS: &str = "takes minutes to hours";
const WEIGHTS: &str = "needs weights of gigabytes";
const SERVER: &str = "needs a server";
const PACKAGE: &str = "needs the Python package";
const NUPLAN: &str = "needs nuPlan's data";
const DEVKIT: &str = "needs clones of nuplan-devkit and tuplan_garage";
const NETWORK: &str = "downloads";
const ENDLESS: &str = "runs until it is ended";
const CHECKPOINT: &str = "needs a checkpoint of a learned planner";
const VALIDATION: &str = "needs the validation recordings";
const FORMER: &str = "needs the run of a command that is not run";

/// Commands that are not run: page, command, reason.
const NOT_RUN: &[(&str, &str, &str)] = &[
    ("docs/python.md", "pip install ./python", CARGO),
    (
        "docs/python.md",
        "pip install maturin ziglang && cd python && maturin build --release --zig --compatibility manylinux2014 --target \
         x86_64-unknown-linux-gnu",
        CARGO,
    ),
    (
        "docs/python.md",
        "python nuplan-devkit/nuplan/planning/script/run_simulation.py +simulation=closed_loop_reactive_agents planner=plan_agent \
         'hydra.searchpath=[pkg://planagent.nuplan.config,pkg://nuplan.planning.script.config.common,pkg://nuplan.planning.script.experiments]'",
        DEVKIT,
    ),
    ("README.md", "git clone REPOSITORY planagent", NETWORK),
    ("README.md", "cd planagent", FORMER),
    ("README.md", "cargo run --release -- simulate", CARGO),
    ("README.md", "cargo test --release", CARGO),
    ("README.md", "cargo install --path .", CARGO),
    (
        "docs/devkit.md",
        "git clone https://github.com/motional/nuplan-devkit && git -C nuplan-devkit checkout e924167",
        NETWORK,
    ),
    (
        "docs/devkit.md",
        "git clone https://github.com/autonomousvision/tuplan_garage && git -C tuplan_garage checkout b51d5d0",
        NETWORK,
    ),
    ("docs/devkit.md", "python3.11 -m venv devkit-python", DEVKIT),
    (
        "docs/devkit.md",
        "devkit-python/bin/pip install -r tests/devkit/requirements.txt",
        NETWORK,
    ),
    (
        "docs/devkit.md",
        "devkit-python/bin/python tests/devkit/compare.py --program target/release/planagent --devkit nuplan-devkit --tuplan \
         tuplan_garage --out compared",
        DEVKIT,
    ),
    (
        "docs/devkit.md",
        "devkit-python/bin/python tests/devkit/compare.py --program target/release/planagent --devkit nuplan-devkit --tuplan \
         tuplan_garage --recordings $PLANAGENT_DATA --workers 2 --out compared",
        DEVKIT,
    ),
    (
        "docs/devkit.md",
        "devkit-python/bin/python tests/devkit/compare.py --program target/release/planagent --devkit nuplan-devkit --tuplan \
         tuplan_garage --scenarios generated/changing_lane/17 generated/traversing_pickup_dropoff/17 --planner pdm-closed \
         --challenge nonreactive --our-rules --out compared",
        DEVKIT,
    ),
    (
        "docs/devkit.md",
        "devkit-python/bin/python tests/devkit/properties.py --devkit nuplan-devkit --exported compared/exported",
        DEVKIT,
    ),
    (
        "docs/learned.md",
        "planagent simulate --planner plantf --checkpoint plantf.ckpt",
        CHECKPOINT,
    ),
    (
        "docs/learned.md",
        "planagent study main --quick --suite generated-test14,generated-test14-hard,recorded",
        CHECKPOINT,
    ),
    (
        "docs/learned.md",
        "planagent simulate --planner plantf,pdm-open,idm --checkpoint plantf=plantf.ckpt --checkpoint pdm-open=pdm_open.ckpt",
        CHECKPOINT,
    ),
    (
        "docs/endpoint.md",
        "planagent simulate --model http://127.0.0.1:8080/v1",
        SERVER,
    ),
    (
        "docs/endpoint.md",
        "planagent simulate --model local-server",
        SERVER,
    ),
    (
        "docs/endpoint.md",
        "OPENAI_API_KEY=… planagent simulate --model openai",
        SERVER,
    ),
    (
        "docs/endpoint.md",
        "planagent simulate --model path/to/description.toml",
        SERVER,
    ),
    ("docs/studies.md", "planagent study main", HOURS),
    ("docs/studies.md", "planagent study all --quick", HOURS),
    (
        "docs/studies.md",
        "planagent study environment --suite generated-test14",
        HOURS,
    ),
    (
        "docs/studies.md",
        "planagent study main --suite recorded --scenario folder/of/recordings",
        HOURS,
    ),
    (
        "docs/studies.md",
        "NUPLAN_DATA_ROOT=… NUPLAN_MAPS_ROOT=… planagent study main --suite val14,test14-hard",
        NUPLAN,
    ),
    (
        "docs/studies.md",
        "planagent study mllm --bench runs/bench-2026.11.20.12.00.00",
        HOURS,
    ),
    (
        "docs/studies.md",
        "planagent study main --quick --csv",
        HOURS,
    ),
    (
        "docs/generator.md",
        "planagent simulate --split generated-test14-candidates --planner pdm-closed --out runs/candidates",
        HOURS,
    ),
    (
        "docs/generator.md",
        "planagent scenarios statistics generated $PLANAGENT_DATA/womd_validation,$PLANAGENT_DATA/argoverse2_validation --figure \
         statistics.svg",
        VALIDATION,
    ),
    (
        "docs/generator.md",
        "planagent scenarios hard runs/candidates > suites/generated-test14-hard.txt",
        FORMER,
    ),
    (
        "docs/latency.md",
        "planagent bench --random-weights nano,llava-1.5-7b,llava-1.5-13b,cogvlm-chat-17b --quantize q4_k",
        HOURS,
    ),
    (
        "docs/latency.md",
        "planagent bench --random-weights smolvlm2-256m,smolvlm2-500m,internvl3-1b,qwen3-vl-2b,qwen3-vl-4b,llava-1.5-7b --quantize \
         q4_k --calls brief,paper --speculation --iterations 3",
        HOURS,
    ),
    (
        "docs/latency.md",
        "planagent bench --random-weights smolvlm2-256m,smolvlm2-500m,internvl3-1b,lfm2-vl-450m,qwen3.5-0.8b,qwen3-vl-2b,\
            llava-1.5-7b --quantize q4_k --calls brief --iterations 2",
        HOURS,
    ),
    (
        "docs/latency.md",
        "planagent bench --random-weights smolvlm2-256m,smolvlm2-500m,internvl3-1b,lfm2-vl-450m,qwen3.5-0.8b,qwen3-vl-2b \
         --quantize q4_k --calls brief --warm-up 1 --iterations 2",
        HOURS,
    ),
    (
        "docs/latency.md",
        "planagent bench --random-weights qwen3-vl-2b --quantize q4_k --calls brief --image-size 448,1024 --iterations 2",
        HOURS,
    ),
    (
        "docs/latency.md",
        "planagent bench --random-weights lfm2.5-vl-1.6b,llava-onevision-0.5b,qwen2-vl-2b,gemma-3-4b,gemma-4-e2b,gemma-3n-e2b --quantize q4_k --calls brief --iterations 2",
        HOURS,
    ),
    (
        "docs/latency.md",
        "planagent simulate --split generated-test14-hard --limit 2 --challenge reactive --threads 1 --model SmolLM2-135M-Instruct.Q4_1.gguf --prompt-set brief",
        WEIGHTS,
    ),
    (
        "docs/latency.md",
        "planagent models quantize SmolLM2-135M-Instruct.Q4_1.gguf --to f32 --out SmolLM2-f32.gguf",
        WEIGHTS,
    ),
    (
        "docs/latency.md",
        "planagent models quantize SmolLM2-f32.gguf --to q8_0 --out SmolLM2-q8_0.gguf",
        WEIGHTS,
    ),
    (
        "docs/latency.md",
        "planagent bench SmolLM2-135M-Instruct.Q4_1.gguf --vs llama.cpp --calls brief --warm-up 1 --iterations 3 --trust-model",
        HOURS,
    ),
    (
        "docs/latency.md",
        "planagent bench --random-weights smolvlm2-256m,llava-1.1b --quantize f32 --calls brief --iterations 1 --weights weights --vs openvino --openvino-python openvino/bin/python --openvino-weights f32",
        HOURS,
    ),
    (
        "docs/latency.md",
        "planagent bench --random-weights smolvlm2-256m,llava-1.1b --quantize q8_0 --calls brief --iterations 3 --weights weights --vs openvino --openvino-python openvino/bin/python --openvino-weights int8",
        HOURS,
    ),
    (
        "docs/latency.md",
        "planagent bench --random-weights smolvlm2-256m,llava-1.1b --quantize q4_k --calls brief --iterations 3 --weights weights --vs openvino --openvino-python openvino/bin/python --openvino-weights int4 --openvino-tower int8",
        HOURS,
    ),
    (
        "docs/latency.md",
        "planagent bench SmolLM2-135M-Instruct.Q4_1.gguf --quantize q8_0 --calls brief --iterations 3 --weights weights --vs openvino --openvino-python openvino/bin/python --trust-model",
        HOURS,
    ),
    (
        "docs/latency.md",
        "planagent bench --random-weights llava-1.1b,llava-1.5-7b --quantize q4_k --vs llama.cpp --llama-python venv/bin/python",
        HOURS,
    ),
    (
        "docs/latency.md",
        "planagent bench --random-weights smolvlm2-256m,internvl3-1b,qwen3-vl-2b,qwen2-vl-2b --quantize q4_k --calls brief --iterations 2 --vs llama.cpp --llama-python venv/bin/python",
        HOURS,
    ),
    (
        "docs/latency.md",
        "planagent bench --random-weights smolvlm2-256m,internvl3-1b,qwen3-vl-2b --quantize q4_k --calls brief --vs llama.cpp --llama-python venv/bin/python",
        HOURS,
    ),
    (
        "docs/latency.md",
        "planagent bench --random-weights llava-1.1b --quantize q4_k --calls brief --iterations 2 --vs llama.cpp --llama-python venv/bin/python",
        HOURS,
    ),
    (
        "docs/latency.md",
        "planagent bench --random-weights llava-1.1b --quantize q8_0 --calls brief --iterations 2 --vs llama.cpp --llama-python venv/bin/python",
        HOURS,
    ),
    (
        "docs/latency.md",
        "planagent bench --random-weights llava-1.5-7b --quantize q4_k --calls brief --warm-up 0 --iterations 1 --vs \
         llama.cpp --llama-python venv/bin/python",
        HOURS,
    ),
    (
        "docs/agents.md",
        "planagent simulate --planner gpt-driver,dilu,agent-driver --model HuggingFaceTB/SmolLM2-135M-Instruct",
        WEIGHTS,
    ),
    (
        "docs/agents.md",
        "planagent simulate --planner gpt-driver --set language_agents.gpt_driver.reflection=true --model HuggingFaceTB/SmolLM2-135M-Instruct",
        WEIGHTS,
    ),
    (
        "docs/agents.md",
        "planagent simulate --planner agent-driver --set language_agents.agent_driver.memory=agent_driver.json --model HuggingFaceTB/SmolLM2-135M-Instruct",
        WEIGHTS,
    ),
    (
        "docs/agents.md",
        "planagent memory fill dilu --out dilu.json --scenarios 20 --model HuggingFaceTB/SmolLM2-135M-Instruct",
        WEIGHTS,
    ),
    (
        "docs/agents.md",
        "planagent simulate --planner dilu --set language_agents.dilu.memory=dilu.json --model HuggingFaceTB/SmolLM2-135M-Instruct",
        WEIGHTS,
    ),
    (
        "docs/llm_assist.md",
        "planagent simulate --split generated --planner pdm-closed,llm-assist-unc,llm-assist-par --model \
         llava-hf/llava-1.5-7b-hf",
        WEIGHTS,
    ),
    (
        "docs/models.md",
        "planagent simulate --model llava-v1.5-7b-Q4_K_M.gguf",
        WEIGHTS,
    ),
    (
        "docs/results.md",
        "planagent simulate --split generated-test14-hard --limit 28 --challenge both --model SmolLM2-135M-Instruct.Q4_1.gguf --prompt-set brief",
        WEIGHTS,
    ),
    (
        "docs/results.md",
        "planagent simulate --scenario folder/of/recordings --shuffle --limit 10 --challenge both --model SmolLM2-135M-Instruct.Q4_1.gguf --prompt-set brief",
        WEIGHTS,
    ),
    (
        "docs/models.md",
        "planagent simulate --model SmolLM2-135M-Instruct.Q4_1.gguf --prompt-set brief",
        WEIGHTS,
    ),
    (
        "docs/models.md",
        "planagent simulate --model llava-hf/llava-1.5-7b-hf",
        WEIGHTS,
    ),
    (
        "docs/models.md",
        "planagent simulate --model http://127.0.0.1:8080/v1",
        SERVER,
    ),
    (
        "docs/models.md",
        "planagent simulate --model local-server",
        SERVER,
    ),
    (
        "docs/models.md",
        "planagent ask \"What blocks the ego's lane?\" --model llava-1.5-7b",
        WEIGHTS,
    ),
    (
        "docs/models.md",
        "planagent ask \"Is the light red?\" --scenario generated/changing_lane/3 --at 3 --model local-server --image scene.png",
        SERVER,
    ),
    (
        "docs/models.md",
        "planagent models fetch llava-1.5-7b",
        NETWORK,
    ),
    ("docs/cards.md", "planagent card", HOURS),
    (
        "docs/cards.md",
        "planagent card --model SmolLM2-135M-Instruct.Q4_1.gguf --prompt-set brief --limit 2",
        WEIGHTS,
    ),
    (
        "docs/results.md",
        "planagent simulate --split generated-test14-hard --limit 14 --challenge reactive --planner pdm-closed,oracle-code,oracle-dilu,oracle-gpt-driver",
        HOURS,
    ),
    (
        "docs/results.md",
        "planagent simulate --split generated-test14-hard --limit 14 --challenge reactive --planner oracle-agent-driver,oracle-llm-assist-unc,oracle-llm-assist-par",
        HOURS,
    ),
    (
        "docs/results.md",
        "planagent simulate --split generated-test14-hard --limit 14 --challenge reactive --planner llm-assist-unc,llm-assist-par --model SmolLM2-135M-Instruct.Q4_1.gguf --prompt-set brief",
        WEIGHTS,
    ),
    (
        "docs/results.md",
        "planagent study ceilings --suite recorded --scenario folder/of/recordings",
        HOURS,
    ),
    (
        "docs/results.md",
        "planagent study agents --limit 2 --suite generated-test14-hard --model SmolLM2-135M-Instruct.Q4_1.gguf --prompt-set brief",
        WEIGHTS,
    ),
    (
        "docs/results.md",
        "planagent study agents --limit 28 --scenario folder/of/recordings --model SmolLM2-135M-Instruct.Q4_1.gguf --prompt-set brief",
        WEIGHTS,
    ),
    (
        "docs/results.md",
        "planagent simulate --split generated-test14-hard --limit 14 --challenge reactive --planner dilu --model SmolLM2-135M-Instruct.Q4_1.gguf --prompt-set brief --adapter adapter --set language_agents.dilu.reflection=true",
        WEIGHTS,
    ),
    (
        "docs/results.md",
        "planagent --seed 16 dataset --for messages --out data/chats --states 3000 --validation 300 --model nano --prompt-set brief --modified 0.5",
        HOURS,
    ),
    (
        "docs/results.md",
        "planagent dataset --for messages --out data/agents --states 2849 --validation 300 --model nano --prompt-set brief --agents gpt-driver,dilu --modified 0.3",
        HOURS,
    ),
    (
        "docs/results.md",
        "planagent simulate --split generated-test14-hard --limit 28 --challenge both --model SmolLM2-135M-Instruct.Q4_1.gguf --prompt-set brief --adapter adapter",
        WEIGHTS,
    ),
    (
        "docs/teach.md",
        "planagent simulate --model FOLDER --adapter adapter",
        WEIGHTS,
    ),
    (
        "docs/teach.md",
        "planagent simulate --planner dilu --model SmolLM2-135M-Instruct.Q4_1.gguf --adapter dilu-adapter",
        WEIGHTS,
    ),
    (
        "docs/nuplan.md",
        "export NUPLAN_DATA_ROOT=/data/nuplan/dataset/nuplan-v1.1/splits/val",
        NUPLAN,
    ),
    (
        "docs/nuplan.md",
        "export NUPLAN_MAPS_ROOT=/data/nuplan/dataset/maps",
        NUPLAN,
    ),
    (
        "docs/nuplan.md",
        "planagent simulate --split val14 --planner idm,pdm-closed --challenge both",
        NUPLAN,
    ),
    (
        "docs/nuplan.md",
        "planagent simulate --scenario $NUPLAN_DATA_ROOT/2021.06.09.17.23.18_veh-38_00773_01140.db#0123456789abcdef",
        NUPLAN,
    ),
    (
        "docs/results.md",
        "planagent simulate --scenario folder/of/recordings --planner plan-agent,pdm-closed,grid-code-four --challenge both",
        HOURS,
    ),
    (
        "docs/results.md",
        "planagent simulate --scenario SCENARIOS --challenge reactive --planner plan-agent,pdm-closed,grid-code-four",
        HOURS,
    ),
    (
        "docs/results.md",
        "planagent study interactive --suite interactive-generated",
        HOURS,
    ),
    (
        "docs/results.md",
        "planagent study interactive --suite interactive-recorded",
        HOURS,
    ),
    (
        "docs/results.md",
        "planagent study main --suite generated-test14-hard",
        HOURS,
    ),
    (
        "docs/results.md",
        "planagent study main --suite recorded",
        HOURS,
    ),
    (
        "docs/modified.md",
        "planagent study interactive --quick",
        HOURS,
    ),
    (
        "docs/reliability.md",
        "cargo test --release --test tests -- fuzz_corpus",
        CARGO,
    ),
    ("docs/reliability.md", "cargo install cargo-fuzz", NETWORK),
    (
        "docs/reliability.md",
        "PROPTEST_CASES=2000 cargo test -p planagent-runs --lib wild_values_in_records",
        CARGO,
    ),
    (
        "docs/reliability.md",
        "python python/tests/mutated_runs.py 900 1",
        PACKAGE,
    ),
    (
        "docs/reliability.md",
        "cargo +nightly fuzz run gguf -- -dict=fuzz/dictionaries/gguf.dict -max_total_time=600 -rss_limit_mb=4096 -timeout=20",
        CARGO,
    ),
    (
        "docs/reliability.md",
        "cargo +nightly fuzz tmin gguf fuzz/artifacts/gguf/crash-0123",
        CARGO,
    ),
    (
        "docs/latency.md",
        "planagent simulate --split generated-test14-hard --challenge both",
        HOURS,
    ),
    (
        "docs/recordings.md",
        "cargo test --release --test tests -- routes_hold_the_recorded_ego",
        CARGO,
    ),
    (
        "docs/recordings.md",
        "planagent study recorded --scenario $PLANAGENT_DATA/womd $PLANAGENT_DATA/argoverse2 $PLANAGENT_DATA/womd_validation \
         $PLANAGENT_DATA/argoverse2_validation",
        VALIDATION,
    ),
    (
        "docs/report.md",
        "planagent serve runs/mine --open",
        ENDLESS,
    ),
    ("docs/report.md", "cd runs/mine", DEVKIT),
    (
        "docs/report.md",
        "NUPLAN_EXP_ROOT=$PWD python $DEVKIT/nuplan/planning/script/run_nuboard.py \
         scenario_builder.data_root=$NUPLAN_DATA_ROOT scenario_builder.map_root=$NUPLAN_MAPS_ROOT \
         simulation_path=\"[$PWD/closed_loop_nonreactive_agents,$PWD/closed_loop_reactive_agents]\"",
        DEVKIT,
    ),
    (
        "docs/report.md",
        "PYTHONPATH=$DEVKIT python tests/devkit/simulation_logs.py runs/exported exported",
        DEVKIT,
    ),
];

/// What of the world outside a command needs that is not here.
fn lack(command: &str) -> Option<Missing> {
    let needs = |words: &[&str]| words.iter().any(|word| command.contains(word));
    let found = [
        needs(&["exec:"]).then(|| python(&[]).err()),
        needs(&["--mp4"]).then(|| program(&["ffmpeg"]).err()),
    ];
    found.into_iter().flatten().flatten().next()
}

/// The paths that a command writes: behind `--out` and `>`.
fn outputs(command: &str) -> impl Iterator<Item = String> {
    let words: Vec<&str> = command.split_whitespace().collect();
    let pairs = words
        .windows(2)
        .filter(|pair| ["--out", ">"].contains(&pair[0]));
    pairs
        .map(|pair| pair[1].trim_end_matches('/').to_owned())
        .collect::<Vec<_>>()
        .into_iter()
}

/// Whether a command names a path, or something below it.
fn names(command: &str, path: &str) -> bool {
    let mut words = command.split(|c: char| c.is_whitespace() || "=,:".contains(c));
    words.any(|word| {
        word.strip_prefix(path)
            .is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
    })
}

/// The commands of a page that were not run for lack of something outside, and those that need what
/// these would have made.
#[derive(Default)]
struct Skipped {
    outputs: Vec<String>,
    reasons: Vec<String>,
}

impl Skipped {
    /// Whether a command of this line is skipped; remembers it if so.
    fn skips(&mut self, line: usize, command: &str) -> bool {
        let input = self.outputs.iter().find(|path| names(command, path));
        let unmade =
            input.map(|path| Missing(format!("needs {path}, which a skipped command makes")));
        let Some(Missing(reason)) = lack(command).or(unmade) else {
            return false;
        };
        self.outputs.extend(outputs(command));
        self.reasons.push(format!("line {line} {reason}"));
        true
    }

    /// A page with skipped commands shows as ignored, although its other commands ran.
    fn outcome(self) -> Needy {
        let reasons = self.reasons.join("; ");
        if reasons.is_empty() {
            Ok(())
        } else {
            Err(Missing(format!("the other commands ran; {reasons}")))
        }
    }
}

/// Writes what a page takes for granted into the folder of its commands.
fn given(page: &str, folder: &Path) {
    match page {
        "README.md" => {
            let text = read(&root().join(page));
            let (_, block) = text.split_once("```python\n").unwrap();
            fs::write(
                folder.join("my_planner.py"),
                block.split_once("```").unwrap().0,
            )
            .unwrap();
            // In the place of Waymo's file, which is not part of the project.
            let recording = folder.join("motion_data_one_scenario.tfrecord");
            written::write(&recording, "generated/changing_lane/3");
        }
        "docs/exec.md" => {
            copy(&root().join("examples"), &folder.join("examples"));
            for (script, example) in [
                ("my_planner", "exec_planner.py"),
                ("my_agents", "exec_agents.py"),
            ] {
                let script = folder.join(script);
                fs::write(
                    &script,
                    format!("#!/bin/sh\nexec python3 examples/{example}\n"),
                )
                .unwrap();
                make_executable(&script);
            }
        }
        "docs/modified.md" => {
            fs::create_dir(folder.join("examples")).unwrap();
            copy(
                &root().join("examples/modified"),
                &folder.join("examples/modified"),
            );
        }
        "docs/studies.md" => {
            let text = read(&root().join(page));
            let (_, block) = text.split_once("```toml\n").unwrap();
            fs::write(
                folder.join("my_study.toml"),
                block.split_once("```").unwrap().0,
            )
            .unwrap();
        }
        "docs/nuplan.md" => {
            written::write(
                &folder.join("recording.tfrecord"),
                "generated/changing_lane/3",
            );
        }
        "docs/models.md" => {
            copy(&root().join("models/nano"), &folder.join("my_model"));
        }
        "docs/prompts.md" => {
            copy(&root().join("prompts/compact"), &folder.join("my_prompts"));
        }
        "docs/runs.md" => {
            let recordings = folder.join("recordings/womd");
            fs::create_dir_all(&recordings).unwrap();
            for (file, scene) in [
                ("one", "generated/changing_lane/3"),
                ("two", "generated/stopping_with_lead/1"),
            ] {
                written::write(&recordings.join(format!("{file}.tfrecord")), scene);
            }
        }
        _ => {}
    }
}

/// Copies the files of a folder.
fn copy(from: &Path, to: &Path) {
    fs::create_dir(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        if path.is_file() {
            fs::copy(&path, to.join(path.file_name().unwrap())).unwrap();
        }
    }
}

#[cfg(unix)]
fn make_executable(path: &Path) {
    use std::os::unix::fs::PermissionsExt;
    fs::set_permissions(path, fs::Permissions::from_mode(0o755)).unwrap();
}

#[cfg(not(unix))]
fn make_executable(_: &Path) {}

/// Runs a line in a shell that finds the built program.
fn shell(line: &str, folder: &Path) -> Output {
    let program = PathBuf::from(env!("CARGO_BIN_EXE_planagent"));
    let mut paths = vec![program.parent().unwrap().to_owned()];
    paths.extend(std::env::split_paths(
        &std::env::var_os("PATH").unwrap_or_default(),
    ));
    let mut command = Command::new("sh");
    command
        .args(["-c", line])
        .current_dir(folder)
        .env("PATH", std::env::join_paths(paths).unwrap());
    for variable in [
        "PLANAGENT_MODELS",
        "NUPLAN_DATA_ROOT",
        "NUPLAN_MAPS_ROOT",
        "NUPLAN_SPLITS_ROOT",
        "NUPLAN_EXP_ROOT",
    ] {
        command.env_remove(variable);
    }
    let caches = [
        ("PLANAGENT_CACHE", "cache"),
        ("HF_HOME", "hub"),
        ("PLANAGENT_DATA", "recordings"),
    ];
    command
        .envs(caches.map(|(variable, name)| (variable, folder.join(name))))
        .env("NO_COLOR", "1");
    command.output().unwrap()
}

fn text(output: &Output) -> String {
    String::from_utf8_lossy(&[output.stdout.as_slice(), &output.stderr].concat()).into_owned()
}

/// Runs the commands of a page, in order.
fn run_page(page: &str) -> Needy {
    let work = TempDir::new().unwrap();
    given(page, work.path());
    let mut skipped = Skipped::default();
    for DocumentedCommand {
        line,
        text: command,
        output: shown,
    } in commands(&read(&root().join(page)))
    {
        if let Some((.., why)) = NOT_RUN
            .iter()
            .find(|(on, listed, _)| *on == page && *listed == command)
        {
            assert!(!why.is_empty());
            continue;
        }
        if skipped.skips(line, &command) {
            continue;
        }
        let output = shell(&command, work.path());
        assert!(
            output.status.success(),
            "{page}:{line}: {command}\n{}",
            text(&output)
        );
        for line in shown {
            assert!(
                text(&output).contains(&line),
                "{page}: {command} does not print {line}\n{}",
                text(&output)
            );
        }
    }
    skipped.outcome()
}

macro_rules! pages {
    ($($name:ident: $page:literal,)+) => {
        /// The pages with commands.
        const PAGES: &[&str] = &[$($page),+];
        $(#[test]
        fn $name() -> Needy {
            run_page($page)
        })+
    };
}

pages! {
    commands_of_the_readme: "README.md",
    commands_of_agents: "docs/agents.md",
    commands_of_cards: "docs/cards.md",
    commands_of_devkit: "docs/devkit.md",
    commands_of_endpoint: "docs/endpoint.md",
    commands_of_exec: "docs/exec.md",
    commands_of_studies: "docs/studies.md",
    commands_of_generator: "docs/generator.md",
    commands_of_latency: "docs/latency.md",
    commands_of_learned: "docs/learned.md",
    commands_of_llm_assist: "docs/llm_assist.md",
    commands_of_models: "docs/models.md",
    commands_of_modified: "docs/modified.md",
    commands_of_nuplan: "docs/nuplan.md",
    commands_of_prompts: "docs/prompts.md",
    commands_of_python: "docs/python.md",
    commands_of_recordings: "docs/recordings.md",
    commands_of_reliability: "docs/reliability.md",
    commands_of_report: "docs/report.md",
    commands_of_results: "docs/results.md",
    commands_of_runs: "docs/runs.md",
    commands_of_teach: "docs/teach.md",
}

#[test]
fn what_a_skipped_command_would_have_made_is_not_used() {
    let mut skipped = Skipped {
        outputs: vec!["exported".to_owned()],
        reasons: Vec::new(),
    };
    assert!(!skipped.skips(1, "planagent simulate --out runs/exported"));
    assert!(skipped.skips(
        2,
        "NUPLAN_MAPS_ROOT=exported/maps planagent simulate --scenario exported/data --out runs/two"
    ));
    assert!(skipped.skips(3, "planagent compare runs/one runs/two > table.csv"));
    assert!(skipped.skips(4, "cut -d, -f1 table.csv"));
    assert!(!skipped.skips(5, "planagent report runs/twofold"));
    let Missing(reason) = skipped.outcome().unwrap_err();
    assert!(
        reason.contains("line 3 needs runs/two, which a skipped command makes"),
        "{reason}"
    );
}

#[test]
fn every_page_with_commands_is_tested() {
    for page in docs() {
        let page_name = name(&page);
        let tested = PAGES.contains(&page_name.as_str());
        assert_eq!(tested, !commands(&read(&page)).is_empty(), "{page_name}");
    }
}

#[test]
fn the_commands_that_are_not_run_are_documented() {
    for (page, command, _) in NOT_RUN {
        let documented = commands(&read(&root().join(page)));
        assert!(
            documented.iter().any(|known| known.text == *command),
            "{page} has no {command}"
        );
    }
}

/// `--help` at the end keeps a command from running, after all before it was read.
#[test]
fn the_program_knows_the_options_of_commands_that_are_not_run() {
    let work = TempDir::new().unwrap();
    fs::create_dir(work.path().join("suites")).unwrap();
    let mut known = 0;
    for (page, command, _) in NOT_RUN {
        // Settings of the environment stand before the program.
        let program = command.split_whitespace().find(|word| !word.contains('='));
        if program != Some("planagent") {
            continue;
        }
        let output = shell(
            &format!("{} --help", command.trim_end_matches(" &")),
            work.path(),
        );
        assert!(
            output.status.success(),
            "{page}: {command}\n{}",
            text(&output)
        );
        known += 1;
    }
    assert!(known > 10);
    let wrong = shell("planagent simulate --plannr idm --help", work.path());
    assert_eq!(
        wrong.status.code(),
        Some(2),
        "an unknown option goes unseen"
    );
}
