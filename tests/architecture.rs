//! The invariants of ARCHITECTURE.md, read off the sources.

mod comments;
mod imports;

use imports::Graph;
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// Stages by rank: a module uses only modules of a smaller rank.
const RANKS: [(&str, u8); 16] = [
    ("files", 0),
    ("child", 0),
    ("kernels", 0),
    ("world", 1),
    ("scenario", 3),
    ("mllm", 3),
    ("score", 3),
    ("agent", 6),
    ("controls", 7),
    ("learned", 7),
    ("language_agents", 8),
    ("planners", 9),
    ("api", 10),
    ("runs", 10),
    ("lab", 12),
    ("cli", 13),
];

/// Rooms of a stage (its files and folders) by rank, lowest first: a room uses only rooms of a
/// lower rank.
const INNER_RANKS: &[(&str, &[&[&str]])] = &[
    (
        "world",
        &[
            &["geometry"],
            &["ego", "object"],
            &["map", "trajectory"],
            &[
                "history",
                "interaction",
                "map_builder",
                "map_query",
                "signal",
            ],
            &["scene"],
            &["path"],
            &["scene_builder"],
            &["dynamics"],
        ],
    ),
    (
        "kernels",
        &[
            &["activation", "read_ahead", "values", "work"],
            &["awake"],
            &["matrix"],
            &[
                "layer_norm",
                "limits",
                "linear",
                "pointwise",
                "rms_norm",
                "sparse_gates",
            ],
            &["attention", "convolution", "delta_rule"],
        ],
    ),
    ("score", &[&["metrics"], &["pdm"]]),
    (
        "agent",
        &[
            &["environment"],
            &["reasoning"],
            &["reflection"],
            &["planner"],
            &["simulation"],
            &["planner_registry"],
        ],
    ),
    (
        "mllm",
        &[
            &["error", "key_variable"],
            &["deadline", "endpoint_settings"],
            &["checkpoint"],
            &["conversation", "gguf"],
            &["adapter", "decoder", "sampling", "text", "vision"],
            &["endpoint", "family"],
            &["template_format"],
            &["tiled"],
            &[
                "cogvlm",
                "internvl",
                "llava",
                "qwen3_vl",
                "smolvlm",
                "text_only",
            ],
            &[
                "gemma3",
                "gemma4",
                "lfm2_vl",
                "llava_next",
                "qwen2_5_vl",
                "qwen2_vl",
                "qwen3_5",
            ],
            &["gemma3n", "llava_onevision"],
            &["families"],
            &["source"],
            &["local"],
            &["export", "latency", "trial"],
            &["registry"],
            // A test of all families.
            &["class_keys"],
        ],
    ),
    (
        "lab",
        &[
            &["rank_correlation", "study", "tokens"],
            &["bench", "dataset"],
            &["memory", "realism", "twins"],
            &["report"],
            &["study_runs"],
            &["card"],
        ],
    ),
    ("runs", &[&["worker"], &["report"], &["runner"]]),
    (
        "runs/runner",
        &[
            &["sample"],
            &[
                "agent_tables",
                "commands",
                "event",
                "machine",
                "result_version",
                "shard",
                "tables",
            ],
            &["of_run"],
            &["config"],
            &["error"],
            &["probe"],
            &["inputs", "model"],
            &["request"],
            &["selection"],
            &["watch"],
            &["run"],
            &["simulate"],
            &["merge"],
        ],
    ),
    (
        "scenario/generator",
        &[
            &["ranges"],
            &["rng"],
            &["road"],
            &["traffic"],
            &["expert"],
            &["scene"],
            &["log"],
            &["scenario_type"],
            &["prelude"],
            &["types"],
            &["spec"],
            &["reader"],
            &["tests"],
        ],
    ),
    (
        "scenario/recording",
        &[
            &["error", "motion", "onward"],
            &["route", "trace"],
            &["lanes", "window"],
            &["junctions", "roadblocks"],
            &["map"],
        ],
    ),
];

/// Most files that may import each other in a circle.
const MAX_CIRCLE: usize = 4;

/// Modules that may write to disk, and nothing else may.
const WRITERS: [&str; 8] = [
    "src/files/open_folder.rs",
    "src/files/whole_file.rs",
    "src/runs/report/",
    "src/lab/",
    "src/cli/",
    "src/mllm/trial/verdicts.rs",
    "src/scenario/nuplan/side_index.rs",
    "src/files/whole_folder.rs",
];

/// Files that hold nothing but unit tests or what only these use.
fn is_test(path: &Path) -> bool {
    let name = path.file_stem().unwrap_or_default().to_string_lossy();
    name == "tests" || name.ends_with("_tests") || name.starts_with("test_") || name == "sketch"
}

fn sources() -> Vec<(String, String)> {
    fn walk(folder: &Path, found: &mut Vec<PathBuf>) {
        let mut entries: Vec<PathBuf> = fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .collect();
        entries.sort();
        for path in entries {
            if path.is_dir() {
                walk(&path, found);
            } else if path.extension().is_some_and(|e| e == "rs") && !is_test(&path) {
                found.push(path);
            }
        }
    }
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut found = Vec::new();
    walk(&root.join("src"), &mut found);
    assert!(found.len() > 50, "only {} sources found", found.len());
    found
        .into_iter()
        .map(|path| {
            let text = fs::read_to_string(&path).unwrap();
            let file = path
                .strip_prefix(root)
                .unwrap()
                .to_string_lossy()
                .into_owned();
            let text = as_one_crate(root, &file, &text);
            (file, text)
        })
        .collect()
}

/// The code of a crate's file as if all crates were modules of one, named by their folders in
/// `src`.
fn as_one_crate(root: &Path, file: &str, text: &str) -> String {
    let own = stage(file).filter(|own| root.join("src").join(own).join("lib.rs").exists());
    let text = own.map_or(text.to_owned(), |own| {
        text.replace("crate::", &format!("crate::{own}::"))
    });
    text.replace("planagent_", "crate::")
}

/// Lines of code with their numbers from 1; comments, doc comments and test items are left out.
fn code_lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    /// A line belongs to a test item until one that ends so, at the item's own indentation.
    struct TestItem<'a> {
        indent: &'a str,
        begun: bool,
        /// Whether an attribute of the item goes over this line.
        in_attribute: bool,
    }
    let mut item: Option<TestItem<'_>> = None;
    text.lines()
        .enumerate()
        .map(|(i, line)| (i + 1, line))
        .filter(move |(_, line)| {
            if let Some(TestItem {
                indent,
                begun,
                in_attribute,
            }) = &mut item
            {
                let own = line.strip_prefix(*indent).unwrap_or_default();
                let opens = !*begun && own.starts_with("#[");
                if *in_attribute || opens {
                    *in_attribute = !own.ends_with(']');
                    return false;
                }
                let whole = !*begun && own.ends_with([';', ',', '}']);
                *begun = true;
                if whole || own == "}" || own == "};" || own == ")" {
                    item = None;
                }
                return false;
            }
            if ["#[cfg(test)]", "#[cfg(all(test,"]
                .iter()
                .any(|attribute| line.trim().starts_with(attribute))
            {
                item = Some(TestItem {
                    indent: &line[..line.len() - line.trim_start().len()],
                    begun: false,
                    in_attribute: false,
                });
                return false;
            }
            !line.trim_start().starts_with("//")
        })
}

fn rank(module: &str) -> Option<u8> {
    RANKS
        .iter()
        .find(|(name, _)| *name == module)
        .map(|&(_, rank)| rank)
}

/// The stage that a source file belongs to.
fn stage(file: &str) -> Option<&str> {
    file.strip_prefix("src/")?
        .split_once('/')
        .map(|(stage, _)| stage)
}

/// All `crate::stage` that a line names, those in braces included.
fn used_stages(line: &str) -> Vec<String> {
    let mut found = Vec::new();
    for (at, _) in line.match_indices("crate::") {
        let rest = &line[at + "crate::".len()..];
        if let Some(inside) = rest.strip_prefix('{') {
            found.extend(inside.split(',').map(str::trim_start).map(first_name));
        } else {
            found.push(first_name(rest));
        }
    }
    found
}

fn first_name(text: &str) -> String {
    text.chars()
        .take_while(|c| c.is_alphanumeric() || *c == '_')
        .collect()
}

#[test]
fn a_stage_uses_only_what_stands_before_it() {
    let mut wrong = Vec::new();
    for (file, text) in sources() {
        let Some(own) = stage(&file) else { continue };
        let own_rank = rank(own).unwrap_or_else(|| panic!("{file} lies in no known stage"));
        for (number, line) in code_lines(&text) {
            for used in used_stages(line) {
                if used != own && rank(&used).is_some_and(|r| r >= own_rank) {
                    wrong.push(format!("{file}:{number}: {own} uses {used}"));
                }
            }
        }
    }
    assert!(
        wrong.is_empty(),
        "against the dependency order:\n{}",
        wrong.join("\n")
    );
}

/// The imports of all files of the stages.
fn graph() -> Graph {
    let code = |text: &str| {
        code_lines(text)
            .flat_map(|(_, line)| [line, "\n"])
            .collect()
    };
    Graph::from_sources(
        &sources()
            .into_iter()
            .map(|(file, text)| (file, code(&text)))
            .collect::<Vec<_>>(),
    )
}

/// The file or folder of a stage that a source file belongs to; none for the stage's own `mod.rs`.
fn room<'a>(file: &'a str, stage: &str) -> Option<&'a str> {
    let inside = file
        .strip_prefix("src/")?
        .strip_prefix(stage)?
        .strip_prefix('/')?;
    let room = inside
        .split_once('/')
        .map_or(inside, |(room, _)| room)
        .trim_end_matches(".rs");
    (!["lib", "mod"].contains(&room)).then_some(room)
}

#[test]
fn a_room_uses_only_rooms_below_it() {
    let graph = graph();
    let mut wrong = BTreeSet::new();
    for (stage, ranks) in INNER_RANKS {
        let rank = |room: &str| {
            let found = ranks.iter().position(|rooms| rooms.contains(&room));
            found.unwrap_or_else(|| panic!("{stage}/{room} has no rank in INNER_RANKS"))
        };
        for (from, to) in graph.imports() {
            if let (Some(own), Some(used)) = (room(from, stage), room(to, stage))
                && own != used
                && rank(used) >= rank(own)
            {
                wrong.insert(format!("{from} uses {to}"));
            }
        }
    }
    assert!(
        wrong.is_empty(),
        "against the order of rooms:\n{}",
        wrong.into_iter().collect::<Vec<_>>().join("\n")
    );
}

#[test]
fn circles_of_imports_are_small() {
    let graph = graph();
    let large: Vec<String> = graph
        .circles()
        .into_iter()
        .filter(|circle| circle.len() > MAX_CIRCLE)
        .map(|circle| format!("{} files:\n  {}", circle.len(), circle.join("\n  ")))
        .collect();
    assert!(
        large.is_empty(),
        "circles of more than {MAX_CIRCLE} files:\n{}",
        large.join("\n")
    );
}

#[test]
fn only_named_modules_write_to_disk() {
    let writes = [
        "fs::write",
        "File::create",
        "create_dir",
        "OpenOptions",
        "fs::rename",
        "remove_file",
        "remove_dir",
        ".save(",
    ];
    let mut wrong = Vec::new();
    for (file, text) in sources() {
        if WRITERS.iter().any(|writer| file.starts_with(writer)) {
            continue;
        }
        for (number, line) in code_lines(&text) {
            if let Some(write) = writes.iter().find(|write| line.contains(**write)) {
                wrong.push(format!("{file}:{number}: {write}"));
            }
        }
    }
    assert!(
        wrong.is_empty(),
        "writes outside {WRITERS:?}:\n{}",
        wrong.join("\n")
    );
}

#[test]
fn only_the_printer_prints() {
    let prints = ["println!", "eprintln!", "print!(", "eprint!(", "dbg!"];
    let mut wrong = Vec::new();
    for (file, text) in sources() {
        if file == "src/cli/printer.rs" {
            continue;
        }
        for (number, line) in code_lines(&text) {
            if let Some(print) = prints.iter().find(|print| line.contains(**print)) {
                wrong.push(format!("{file}:{number}: {print}"));
            }
        }
    }
    assert!(
        wrong.is_empty(),
        "prints outside the printer:\n{}",
        wrong.join("\n")
    );
}

#[test]
fn a_planner_input_holds_no_future() {
    let text =
        fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("src/agent/planner/mod.rs"))
            .unwrap();
    let start = text
        .find("pub struct PlannerInput")
        .expect("PlannerInput is defined in src/agent/planner/mod.rs");
    let body = &text[start..start + text[start..].find('}').unwrap()];
    let fields: Vec<&str> = body
        .lines()
        .filter(|line| line.trim_start().starts_with("pub ") && line.contains(':'))
        .collect();
    let allowed = ["iteration", "scene"];
    for field in &fields {
        assert!(
            allowed
                .iter()
                .any(|name| field.contains(&format!("pub {name}:"))),
            "unexpected field: {field}"
        );
    }
    assert_eq!(fields.len(), allowed.len(), "{body}");
}

#[test]
fn the_simulator_knows_an_agent_only_by_the_trait() {
    let known = [
        "PlanAgent",
        "plan_agent",
        "IdmPlanner",
        "LogReplay",
        "reasoning",
        "reflection",
        "mllm",
    ];
    let simulation = sources()
        .into_iter()
        .filter(|(file, _)| file.starts_with("src/agent/simulation/"));
    for (file, text) in simulation {
        for (number, line) in code_lines(&text) {
            assert!(
                !known.iter().any(|name| line.contains(name)),
                "{file}:{number}: {line}"
            );
        }
    }
}

#[test]
fn files_stay_readable() {
    /// A file longer than this holds more than one idea.
    const MAX_LINES: usize = 600;
    let long: Vec<String> = sources()
        .into_iter()
        .filter(|(_, text)| text.lines().count() > MAX_LINES)
        .map(|(file, text)| format!("{file}: {} lines", text.lines().count()))
        .collect();
    assert!(
        long.is_empty(),
        "files over {MAX_LINES} lines:\n{}",
        long.join("\n")
    );
}

/// The reasons of the calls of `expect` in a source, each with its line; none where it is no text
/// of the source.
fn reasons(text: &str) -> Vec<(usize, Option<String>)> {
    let lines: Vec<(usize, &str)> = code_lines(text).collect();
    let mut found = Vec::new();
    for (place, &(number, line)) in lines.iter().enumerate() {
        for (at, call) in line.match_indices(".expect(") {
            let rest = match &line[at + call.len()..] {
                "" => lines
                    .get(place + 1)
                    .map_or("", |(_, next)| next.trim_start()),
                rest => rest,
            };
            let reason = rest
                .strip_prefix('"')
                .and_then(|rest| rest.split('"').next());
            found.push((number, reason.map(str::to_owned)));
        }
    }
    found
}

#[test]
fn an_invariant_says_why_it_holds() {
    /// Fewer words only name what is missing.
    const MIN_WORDS: usize = 4;
    let mut wrong = Vec::new();
    for (file, text) in sources() {
        for (number, reason) in reasons(&text) {
            if reason
                .as_ref()
                .is_none_or(|reason| reason.split_whitespace().count() < MIN_WORDS)
            {
                wrong.push(format!("{file}:{number}: {reason:?}"));
            }
        }
    }
    assert!(
        wrong.is_empty(),
        "reasons of fewer than {MIN_WORDS} words; say why it holds:\n{}",
        wrong.join("\n")
    );
}

/// Finds lines and names in a text, of which the second argument says which lines are code.
type Find<'f> = dyn Fn(&str, &dyn Fn(usize) -> bool) -> Vec<(usize, String)> + 'f;

/// The faults that `find` sees in the sources, each with its place.
fn without_comment(find: &Find<'_>) -> Vec<String> {
    let mut found = Vec::new();
    let is_product = |(file, _): &(String, String)| !file.contains("/tests/");
    for (file, text) in sources().into_iter().filter(is_product) {
        let code: BTreeSet<usize> = code_lines(&text).map(|(number, _)| number).collect();
        let places = find(&text, &|number| code.contains(&number));
        found.extend(
            places
                .into_iter()
                .map(|(number, name)| format!("{file}:{number}: {name}")),
        );
    }
    found
}

#[test]
fn a_long_function_says_why() {
    /// A longer function is not read at a glance.
    const MAX_LINES: usize = 30;
    let found =
        without_comment(&|text, code| comments::unexplained_functions(text, code, MAX_LINES));
    assert!(
        found.is_empty(),
        "functions over {MAX_LINES} lines without a comment; split them, or say why at the place where \
        a reader would ask:\n{}",
        found.join("\n")
    );
}

#[test]
fn a_constant_of_numbers_says_what_they_are() {
    let found = without_comment(&comments::unexplained_numbers);
    assert!(
        found.is_empty(),
        "constants without a comment; give unit and origin:\n{}",
        found.join("\n")
    );
}

#[test]
fn defaults_in_the_place_of_invariants_do_not_return() {
    /// Each was read: absence means the default there. A new one takes the place of another, or of
    /// an error or an `expect`.
    const MAX_DEFAULTS: usize = 80;
    let lines = |text: &str| {
        code_lines(text)
            .filter(|(_, line)| line.contains(".unwrap_or_default()"))
            .count()
    };
    let found: usize = sources().iter().map(|(_, text)| lines(text)).sum();
    assert!(
        found <= MAX_DEFAULTS,
        "{found} lines with `unwrap_or_default()`, at most {MAX_DEFAULTS}"
    );
}

#[test]
fn the_scanner_sees_what_it_should() {
    assert_eq!(
        used_stages("use crate::{geometry::Pose, cli};"),
        ["geometry", "cli"]
    );
    assert_eq!(
        used_stages("    let x = crate::report::table();"),
        ["report"]
    );
    let text = "a\n#[cfg(test)]\n#[allow(\n    x,\n)]\nmod tests {\n    b,\n}\nc";
    assert_eq!(code_lines(text).collect::<Vec<_>>(), [(1, "a"), (9, "c")]);
    let text = "a\n// crate::cli\n#[cfg(test)]\nmod x;\nb\n#[cfg(test)]\nmod tests {\n    c\n}\nd";
    assert_eq!(
        code_lines(text).collect::<Vec<_>>(),
        [(1, "a"), (5, "b"), (10, "d")]
    );
    let text = "a.expect(\"it is so\").b\n  .expect(\n    \"of two lines\",\n  )\nc.expect(d)";
    let expected = [
        (1, Some("it is so".to_owned())),
        (2, Some("of two lines".to_owned())),
        (5, None),
    ];
    assert_eq!(reasons(text), expected);
}
