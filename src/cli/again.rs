//! Commands that a message tells the user to type: they hold what the command line said, so that
//! they work as they stand.

use planagent_files::{quoted, word_of};
use std::ffi::OsString;
use std::path::Path;
use std::sync::OnceLock;

/// The words of this command line; the program may run inside another one.
static WORDS: OnceLock<Vec<OsString>> = OnceLock::new();

/// Options of `simulate` that a run folder does not answer for: the user's own models, servers,
/// and files of settings.
const OF_THE_USER: [&str; 2] = ["--model", "--config"];
/// The same without a value.
const SWITCHES: [&str; 3] = ["--offline", "--trust-model", "--ignore-memory"];
/// Options with commands, which a run folder never starts.
const COMMANDS: [&str; 3] = ["--planner", "--agents", "--exec-timeout"];

/// The command that resumes a run.
pub(super) fn resume_run(folder: &Path, has_commands: bool, named_again: &[[String; 2]]) -> String {
    of_run(&arguments(), folder, has_commands, named_again)
}

/// The command that resumes this one, whose results are in a folder.
pub(super) fn resume_this(folder: &Path) -> String {
    of_this(&arguments(), folder)
}

/// The words of this command line. The first call stays.
pub(super) fn remember(words: &[OsString]) {
    let _ = WORDS.set(words.to_vec());
}

/// The words of this command line without the program.
fn arguments() -> Vec<String> {
    let words = WORDS.get().map_or(&[][..], Vec::as_slice);
    words.iter().skip(1).map(|word| word_of(word)).collect()
}

fn of_run(
    arguments: &[String],
    folder: &Path,
    has_commands: bool,
    named_again: &[[String; 2]],
) -> String {
    let kept = |option: &str| {
        OF_THE_USER.contains(&option) || (has_commands && COMMANDS.contains(&option))
    };
    let mut words = vec!["planagent".to_owned(), "simulate".to_owned()];
    words.extend(["--resume".to_owned(), word_of(folder.as_os_str())]);
    let mut rest = arguments.iter();
    while let Some(word) = rest.next() {
        let (option, value) = match word.split_once('=') {
            Some((option, _)) if word.starts_with("--") => (option, Some(())),
            _ => (word.as_str(), None),
        };
        if SWITCHES.contains(&option) {
            words.push(word.clone());
        } else if kept(option) {
            words.push(word.clone());
            if value.is_none() {
                words.extend(rest.next().cloned());
            }
        }
    }
    // A file of settings may have named the model.
    for named in named_again {
        let [option, _] = named;
        let is_there = |word: &String| {
            word.strip_prefix(option.as_str())
                .is_some_and(|rest| rest.is_empty() || rest.starts_with('='))
        };
        if option == "--checkpoint" || !words.iter().any(is_there) {
            words.extend(named.iter().cloned());
        }
    }
    shown(&words)
}

fn of_this(arguments: &[String], folder: &Path) -> String {
    let mut words = vec!["planagent".to_owned()];
    let mut rest = arguments.iter();
    while let Some(word) = rest.next() {
        match word.as_str() {
            "--out" | "--resume" => {
                rest.next();
            }
            word if word.starts_with("--out=") || word.starts_with("--resume=") => {}
            word => words.push(word.to_owned()),
        }
    }
    words.extend(["--resume".to_owned(), word_of(folder.as_os_str())]);
    shown(&words)
}

/// Words as a shell takes them.
fn shown(words: &[String]) -> String {
    let words: Vec<String> = words.iter().map(|word| quoted(word)).collect();
    words.join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(line: &str) -> Vec<String> {
        line.split(' ').map(|word| word.replace('_', " ")).collect()
    }

    #[test]
    fn a_resumed_run_gets_what_its_folder_does_not_answer_for() {
        let line = "simulate --split generated --model m.toml --offline --seed 3 --config=c.toml \
                    --planner a=exec:./a_b --agents=b=exec:./b -q";
        let folder = Path::new("runs/my run");
        assert_eq!(
            of_run(&words(line), folder, false, &[]),
            "planagent simulate --resume 'runs/my run' --model m.toml --offline --config=c.toml"
        );
        let named = [
            ["--model".to_owned(), "/home/m.toml".to_owned()],
            ["--checkpoint".to_owned(), "plantf=/a b.ckpt".to_owned()],
        ];
        assert_eq!(
            of_run(&words("simulate --model m.toml"), folder, false, &named),
            "planagent simulate --resume 'runs/my run' --model m.toml --checkpoint 'plantf=/a b.ckpt'"
        );
        assert_eq!(
            of_run(&words("simulate"), folder, false, &named[..1]),
            "planagent simulate --resume 'runs/my run' --model /home/m.toml"
        );
        assert_eq!(
            of_run(&words(line), folder, true, &[]),
            "planagent simulate --resume 'runs/my run' --model m.toml --offline --config=c.toml --planner \
             'a=exec:./a b' --agents=b=exec:./b"
        );
    }

    #[test]
    fn a_command_that_is_resumed_has_its_folder_in_place_of_the_new_one() {
        for line in [
            "bench nano --out be --iterations 3",
            "bench nano --out=be --iterations 3",
            "bench nano --resume be --iterations 3",
            "bench nano --iterations 3",
        ] {
            assert_eq!(
                of_this(&words(line), Path::new("be")),
                "planagent bench nano --iterations 3 --resume be"
            );
        }
    }
}
