//! Words of the command line that are more than one value.

use clap::builder::{OsStringValueParser, TypedValueParser};
use planagent_agent::planner::is_exec;
use planagent_files::word_of;
use planagent_runs::runner::{NoShard, Shard, ShardEnvironmentError};
use std::env;

/// Takes a path that need not be UTF-8, or another word.
pub(super) fn path_word() -> impl TypedValueParser<Value = String> {
    OsStringValueParser::new().map(|word| word_of(&word))
}

/// The words of the values of `--planner`: names separated by commas. A command takes the rest of
/// its value, commas included.
pub(super) fn planner_words(values: &[String]) -> Vec<String> {
    let mut words = Vec::new();
    for value in values {
        let mut rest = value.as_str();
        while let Some((name, after)) = rest.split_once(',').filter(|_| !is_exec(rest)) {
            words.push(name.trim().to_owned());
            rest = after;
        }
        words.push(rest.trim().to_owned());
    }
    words
}

/// A word that names no shard.
#[derive(Debug, thiserror::Error)]
pub(super) enum ShardWordError {
    #[error(transparent)]
    NoShard(#[from] NoShard),
    #[error(transparent)]
    Environment(#[from] ShardEnvironmentError),
    #[error(
        "neither SLURM_ARRAY_TASK_ID nor NODE_RANK is set; name the shard as I/N, for example 2/8"
    )]
    NoEnvironment,
}

/// What is no count.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("expected a whole number from 1 on")]
pub(super) struct NoCount;

/// A number of things, at least one.
pub(super) fn count(word: &str) -> Result<usize, NoCount> {
    word.parse().ok().filter(|&count| count > 0).ok_or(NoCount)
}

/// The value of `--shard`.
pub(super) fn shard_word(word: &str) -> Result<Shard, ShardWordError> {
    if word == "auto" {
        return Shard::of_environment(|name| env::var(name).ok())?
            .ok_or(ShardWordError::NoEnvironment);
    }
    Ok(word.parse()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_keeps_its_commas() {
        let words = |values: &[&str]| {
            planner_words(&values.iter().map(ToString::to_string).collect::<Vec<_>>())
        };
        assert_eq!(
            words(&["idm, pdm-closed", "simple"]),
            ["idm", "pdm-closed", "simple"]
        );
        assert_eq!(
            words(&["idm,exec:python3 a.py --x 1,2"]),
            ["idm", "exec:python3 a.py --x 1,2"]
        );
        assert_eq!(
            words(&["idm,mine=exec:./a 1,2"]),
            ["idm", "mine=exec:./a 1,2"]
        );
        assert_eq!(
            words(&["mine=exec:./a 1,2", "idm"]),
            ["mine=exec:./a 1,2", "idm"]
        );
    }
}
