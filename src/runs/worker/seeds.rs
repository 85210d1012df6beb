//! Which seeds are for training, validation and test.

use std::ops::Range;

/// A part of the seeds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Split {
    Train,
    /// For the evaluation during training.
    Validation,
    /// For the evaluation of a trained model; no choice depends on it.
    Test,
}

impl Split {
    /// Name in file names.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::Validation => "validation",
            Self::Test => "test",
        }
    }

    /// Seeds of the split. Smaller ones are for tests of the program and demonstrations.
    pub fn seeds(self) -> Range<u64> {
        match self {
            Self::Train => 10_000_000..20_000_000,
            Self::Validation => 20_000_000..30_000_000,
            Self::Test => 30_000_000..40_000_000,
        }
    }
}
