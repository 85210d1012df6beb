//! Runs the tests. Unlike the compiler's harness, it can show a test as ignored that lacks
//! something on this machine.
//!
//! A test that needs more than the repository returns [`Needy`](crate::outside::Needy). With
//! `--ignored`, these tests run alone.

use crate::outside::{Missing, Needy};
use libtest_mimic::{Arguments, Completion, Failed, Trial};
use std::process::ExitCode;

/// A function with `#[test]`, as `tests/attribute` registers it.
pub(crate) struct Test {
    /// Its path, the name of the binary first.
    pub path: &'static str,
    /// Whether it needs more than the repository.
    pub is_needy: bool,
    pub run: fn() -> Completion,
}

inventory::collect!(Test);

/// What a test function returns.
pub(crate) trait Outcome {
    /// Whether the type has a value for what is missing.
    const IS_NEEDY: bool;

    fn completion(self) -> Completion;
}

impl Outcome for () {
    const IS_NEEDY: bool = false;

    fn completion(self) -> Completion {
        Completion::Completed
    }
}

impl Outcome for Needy {
    const IS_NEEDY: bool = true;

    fn completion(self) -> Completion {
        match self {
            Ok(()) => Completion::Completed,
            Err(Missing(reason)) => Completion::ignored_with(reason),
        }
    }
}

/// Whether a test function may find something missing.
pub(crate) const fn is_needy<T: Outcome>(_: fn() -> T) -> bool {
    T::IS_NEEDY
}

/// Runs the tests that the arguments of the command line name.
pub(crate) fn run() -> ExitCode {
    let arguments = Arguments::from_args();
    let trials = inventory::iter::<Test>.into_iter().map(|test| {
        let path = test
            .path
            .split_once("::")
            .map_or(test.path, |(_, path)| path);
        let trial = Trial::ignorable_test(path, || Ok::<_, Failed>((test.run)()));
        // A needy test always runs, and reports what it lacks. The flag is what `--ignored` selects
        // by.
        trial.with_ignored_flag(test.is_needy && arguments.ignored)
    });
    let mut trials: Vec<Trial> = trials.collect();
    trials.sort_by(|one, other| one.name().cmp(other.name()));
    libtest_mimic::run(&arguments, trials).exit_code()
}
